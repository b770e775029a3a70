"""`solver: auto` and `accuracy`: choice of solver and step, for cloth and for dye, by trials before a run. The scene
itself is read in `nuno.scene`, which uses neither.
"""
