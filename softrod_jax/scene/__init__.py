"""What a robot is: its sections, actuators and loads, in Python and in files."""
