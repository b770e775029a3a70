"""How bodies move in time, each a plugin; no shape stands here."""
