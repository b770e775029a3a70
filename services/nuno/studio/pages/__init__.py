"""Pages for a browser of this machine: their server, its access control, and shared files."""
