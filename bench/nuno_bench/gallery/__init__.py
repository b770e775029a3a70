"""`nuno gallery`: shipped scenes of dye, knits and wrinkles in pictures, and what the papers say they must show."""
