"""Measures the rest of the project: speed against its bars, integrators against each other."""
