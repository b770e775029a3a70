"""Fabrics in measured units: presets, the constants they give a mesh, and virtual tests of them."""
