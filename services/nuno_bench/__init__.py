"""Measures the rest of the project: a folder for each measurement, a file where one is enough, and what they share."""
