"""Building the simulated cloth of a scene, and measurements on it."""
