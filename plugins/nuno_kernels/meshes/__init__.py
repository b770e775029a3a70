"""Triangle meshes: files, checks, closest points, sections, limbs. What makes meshes is a plugin."""
