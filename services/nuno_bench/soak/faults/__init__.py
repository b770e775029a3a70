"""What a run makes of services that are killed, and what is left of it."""
