"""A page for scenes, runs and recordings in a browser, served on loopback."""
