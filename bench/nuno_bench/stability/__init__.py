"""`nuno bench stability`: what solvers make of a scene over stiffness, mesh and step."""
