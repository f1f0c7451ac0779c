"""The rod at one instant: its constants, strains and ordinary differential equation."""
