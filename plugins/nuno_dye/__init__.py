"""Dyeing of woven cloth: cells, diffusion, adsorption."""
