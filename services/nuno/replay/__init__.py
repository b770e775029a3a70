"""Recordings played again: published on the bus as they were, at their pace or faster."""
