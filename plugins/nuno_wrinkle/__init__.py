"""Wrinkles from ridge and valley lines (the wrinkle paper)."""
