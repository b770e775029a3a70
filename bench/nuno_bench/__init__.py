"""Benchmarks of the project: a folder or a file for each measurement, and shared tools."""
