"""Where cloth to dye comes from: cells in a file, a weave, a photograph."""
