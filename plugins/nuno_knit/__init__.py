"""Knitted cloth: points where yarns cross, joined by links of yarns."""
