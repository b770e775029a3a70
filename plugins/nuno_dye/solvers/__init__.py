"""Methods that step dye in time, each a plugin, and what they share; the laws that they solve are in `laws`."""
