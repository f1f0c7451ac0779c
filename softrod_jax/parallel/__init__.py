"""Many samples at once: over cores and devices, and in parts that can be resumed."""
