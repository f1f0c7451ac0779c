"""What every call rests on: float64, compiled programs, result codes, whole files."""
