"""Contact that no vertex passes: movements held off triangle meshes, with friction along them."""
