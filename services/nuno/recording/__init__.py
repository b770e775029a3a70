"""Recordings: one MCAP per run, written by the recorder service, read as a `Recording`."""
