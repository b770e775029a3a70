"""Eight float64 lanes as one value, choices between them, and vectors in space of them. Mathematics that one plugin
alone uses is that plugin's.
"""
