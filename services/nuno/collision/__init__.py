"""Bodies: where they are, their surfaces, how deep cloth lies in them, and the service that says so."""
