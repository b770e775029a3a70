"""One scene, one digest, in every way that it can be run."""
