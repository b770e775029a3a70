"""Supplies of dye to a cloth, resists that keep dye out, and their regions."""
