"""Eight float64 lanes as one value, and choices between them. Mathematics that one plugin alone uses is that
plugin's.
"""
