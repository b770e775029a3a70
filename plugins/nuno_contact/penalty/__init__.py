"""Contact by penalty forces with static friction, against primitives and distance fields; also as a constraint for
XPBD.
"""
