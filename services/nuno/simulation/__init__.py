"""Cloth in motion: state, solver, operations on it, and the service that steps it. Building it is `nuno.cloth`."""
