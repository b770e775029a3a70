"""Garments sewn from patterns: the file, its panels and seams, what is wrong with them, and their triangles."""
