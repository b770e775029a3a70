"""A scene as a problem for solvers: run without services, observed, and the reference that it is held against."""
