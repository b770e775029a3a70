"""The common parts of solvers' steps: a system in the kernels' layout, blocks of vertices, the acceleration. Methods
are plugins.
"""
