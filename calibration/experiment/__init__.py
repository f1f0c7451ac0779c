"""What surrounds the robot on the bench: its setup, clock, release and beginning."""
