"""Turns a recording into files that other programs read: arrays, meshes, tables, pictures."""
