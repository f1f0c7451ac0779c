"""Recordings: from the files of laboratories to tip positions and inputs in SI units."""
