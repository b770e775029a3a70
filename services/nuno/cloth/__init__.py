"""From a loaded scene to the cloth that is simulated, and what is measured on it."""
