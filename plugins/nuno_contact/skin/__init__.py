"""A body whose skin follows its joints: where these lie in a mesh, how much each carries of it, and how a motion of
another skeleton becomes its own.
"""
