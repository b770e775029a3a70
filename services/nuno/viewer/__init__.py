"""Shows runs in rerun: live, replayed, or written to a file."""
