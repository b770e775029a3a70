"""Every solver's error over the wall time it takes, what two sweeps differ in, and what `accuracy` delivers."""
