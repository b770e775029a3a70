"""Triangle meshes: files, checks, closest points, sections, limbs. Plugins make meshes."""
