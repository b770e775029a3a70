"""Cloth that meets itself and other cloth: pairs of primitives that come near, what pushes them apart, and what keeps
them from ever passing through each other. Bodies are in penalty and sliding.
"""
