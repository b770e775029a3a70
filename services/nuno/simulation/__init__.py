"""Cloth in motion: state, solver, operations on it, and the service that steps it; `cloth` builds it, and
`solver_selection` chooses its solver.
"""
