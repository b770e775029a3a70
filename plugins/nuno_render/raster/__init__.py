"""The renderer for meshes, by a z-buffer."""
