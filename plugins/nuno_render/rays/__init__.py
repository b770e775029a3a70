"""Pictures of yarns and of values on bodies, by rays."""
