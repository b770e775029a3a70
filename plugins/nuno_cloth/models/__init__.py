"""Garments and sheets, each a plugin: their meshes, patterns, and where they start."""
