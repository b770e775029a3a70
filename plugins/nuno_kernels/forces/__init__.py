"""What fabric itself does: springs, hinges, yarns, their energies and matrices. Wind and contact are plugins."""
