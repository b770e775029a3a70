"""A body whose skin follows its joints: their places in a mesh, the weights of bones, and retargeted motions."""
