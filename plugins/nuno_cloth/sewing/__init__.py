"""Garments sewn from patterns: the file, its panels and seams, their faults, and their triangles."""
