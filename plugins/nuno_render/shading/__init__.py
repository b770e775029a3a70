"""Lights, maps of what they reach, and shading; shared by `raster` and `rays`."""
