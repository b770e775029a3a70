"""Weaves, and drafts from Weaving Information Files."""
