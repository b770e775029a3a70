"""`nuno validate`: the laws of physics, held against every installed solver."""
