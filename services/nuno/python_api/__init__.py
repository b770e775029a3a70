"""The Python API: the same runs as on the command line, from a script or a notebook. `nuno` exports all of it."""
