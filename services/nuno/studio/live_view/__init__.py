"""Cloth as a page shows it: a scene's start, and a run that goes on, by its newest state."""
