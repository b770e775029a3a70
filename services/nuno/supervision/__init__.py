"""A run as a whole: starting its services, watching them, ending them in order, and what is told of it."""
