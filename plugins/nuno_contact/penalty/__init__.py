"""Contact by penalty forces with friction that sticks, against primitives and distance fields; also as a constraint
for XPBD.
"""
