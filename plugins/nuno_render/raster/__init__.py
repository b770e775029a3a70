"""The renderer for meshes: what each sample sees, found by a z-buffer."""
