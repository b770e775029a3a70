"""Scenes to begin from: after those that come with nuno, and garments that bodies wear."""
