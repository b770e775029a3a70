"""The physics of a cell and of a face between two: isotherms, adsorption, diffusivity, with the powers and logarithms
that they take.
"""
