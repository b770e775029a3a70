"""Meshes of bodies from measurements: a leg and a torso. Meshes from files are in `colliders`."""
