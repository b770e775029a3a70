"""The report of a run, made from its services' counts, and its text."""
