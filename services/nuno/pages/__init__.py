"""Pages for a browser of this machine: one server, who may ask it, and what its pages share."""
