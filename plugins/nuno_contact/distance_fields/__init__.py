"""Sampled distance fields of meshes: building, caching and reading."""
