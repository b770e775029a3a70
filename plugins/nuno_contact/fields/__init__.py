"""Sampled distance fields of meshes: built, kept on disk, and read."""
