"""Contact of cloth with itself, other cloth and bodies of triangles: near pairs of primitives, the forces between them,
and shortened steps, so that none ever pass through each other.
"""
