"""Cloth to dye, from cells in a file, a weave or a photograph."""
