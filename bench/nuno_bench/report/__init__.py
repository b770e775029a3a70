"""Presentation of measurements: results, tables, pages with their data, sections of the documentation, plots."""
