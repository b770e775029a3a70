"""Contact of cloth with itself and other cloth: near pairs of primitives, the forces between them, and shortened steps,
so that none ever pass through each other. Contact with bodies is in penalty and sliding.
"""
