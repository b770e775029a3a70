"""Ray-traced pictures of yarns during a run."""
