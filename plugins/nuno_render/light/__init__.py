"""Lights, the maps that say what they reach, and shading; shared by `raster` and `rays`."""
