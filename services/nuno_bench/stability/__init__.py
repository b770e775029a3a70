"""What solvers make of a scene over stiffness, mesh and step, and of one mode over many steps."""
