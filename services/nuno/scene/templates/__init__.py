"""Templates of scenes: copies of shipped ones, garments on a body, and fabrics of laboratory sheets."""
