"""Recordings simulated again: compared to the last bit, and read in float64 at any frame."""
