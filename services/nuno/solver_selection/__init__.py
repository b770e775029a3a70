"""`solver: auto` and `accuracy`: which solver and which step, of cloth and of dye, tried before a run. What a
scene says itself is read in `nuno.scene`, which knows neither.
"""
