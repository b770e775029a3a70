"""XPBD: its step, and sweeps over compliant constraints; those of springs and hinges are in nuno_kernels.forces."""
