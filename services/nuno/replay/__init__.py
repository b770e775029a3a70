"""Recordings played again: published on the bus, simulated again, compared, and read in float64 at any frame."""
