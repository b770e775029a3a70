"""The dye service: spreading of dye in woven cloth."""
