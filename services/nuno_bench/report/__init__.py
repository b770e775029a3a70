"""How what was measured is told: results, tables, pages with their data, sections of the documentation, plots."""
