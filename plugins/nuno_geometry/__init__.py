"""Meshes and bodies that several plugins share: poses, files, checks, closest points, sections, limbs."""
