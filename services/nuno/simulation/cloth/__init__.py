"""The cloth of a scene: its start, its checks, and measurements on it."""
