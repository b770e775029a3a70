"""Vertices taken hold of, and let go of, while a simulation goes on."""
