"""Fits to postures: each row of a recording is an equilibrium, not a moment of a motion."""
