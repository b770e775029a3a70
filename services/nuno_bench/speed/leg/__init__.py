"""What a stocking on a leg costs: closest points, a distance field, the fit, a picture of its yarns."""
