"""Measurements of the calibration itself; each is a script, too slow for a test."""
