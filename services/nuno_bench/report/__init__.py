"""How what was measured is shown: results, tables, pages with their data, sections of the documentation, plots."""
