"""Forces of fabric: springs, hinges, yarns, their energies, matrices, constraints. Wind and contact are plugins."""
