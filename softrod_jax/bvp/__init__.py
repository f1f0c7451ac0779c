"""The boundary value problem along the rod: methods, Newton, continuation."""
