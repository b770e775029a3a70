"""How a garment fits the body that wears it: girths and ease, strain, pressure."""
