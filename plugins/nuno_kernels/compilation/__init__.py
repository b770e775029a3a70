"""Compilation and caching of kernels: their dependencies, calls between them, and machine code on disk."""
