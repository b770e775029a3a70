"""`nuno bench precision`, `compare` and `accuracy`: errors of solvers over the wall time that they take."""
