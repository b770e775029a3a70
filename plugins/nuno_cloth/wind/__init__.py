"""Wind and air drag: the plugins and their kernels."""
