"""Pictures of the shipped scenes of dye, knits and wrinkles, and whether they show what the papers say of them."""
