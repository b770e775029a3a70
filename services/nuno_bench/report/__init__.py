"""How what was measured is told: results and tables, sections of the documentation, pages, plots, rerun files."""
