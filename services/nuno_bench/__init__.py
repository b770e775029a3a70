"""Measures the rest of the project: a folder for each thing that is measured, and what they share beside them."""
