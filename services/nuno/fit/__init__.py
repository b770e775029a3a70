"""Fit of a garment on the body that wears it: girths and ease, strain, pressure."""
