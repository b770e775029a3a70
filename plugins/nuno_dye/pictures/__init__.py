"""Pictures of dyed cloth: colours of dye, and yarns with their shade."""
