"""`nuno bench contact`: random scenes in which cloth meets cloth, every frame looked at by ipc-toolkit."""
