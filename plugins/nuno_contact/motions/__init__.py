"""Motions of bodies, each a plugin; shapes are in `colliders`."""
