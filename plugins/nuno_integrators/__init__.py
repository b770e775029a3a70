"""Explicit integrators: euler, symplectic_euler, leapfrog, rk4 and rk4_printed."""
