"""What every solver's step needs: a system in the kernels' layout, blocks of vertices, the acceleration. Methods that
step are plugins.
"""
