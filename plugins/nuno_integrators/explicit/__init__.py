"""Explicit methods: the next state follows from forces alone, with fixed or adaptive steps."""
