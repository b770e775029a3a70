"""Motions of bodies' frames within a frame of animation, and the vertices that they carry; contact is a plugin."""
