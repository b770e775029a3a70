"""The dye service: dye spreads in a woven cloth that does not move."""
