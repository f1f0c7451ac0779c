"""The motions of recordings under trial values, and how far they are from the data."""
