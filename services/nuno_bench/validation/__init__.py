"""The laws of physics, held against every installed solver."""
