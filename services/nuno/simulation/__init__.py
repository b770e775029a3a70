"""Cloth in motion: its state and solver, operations on it, and the service that steps it. Building it is
`nuno.cloth`.
"""
