"""Pictures of yarns by rays while a scene runs."""
