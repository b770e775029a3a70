"""Fabrics in measured units, the garments made of them, and wind."""
