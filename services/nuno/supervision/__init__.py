"""Supervision of a run: starting its services, watching them, ending them in order, logging, and the list of runs."""
