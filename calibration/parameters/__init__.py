"""What can be fitted, on which scale, and which of it a call asks for."""
