"""Contact that no vertex passes: movements constrained by triangle meshes, with friction along them."""
