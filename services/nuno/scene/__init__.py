"""From a scene's file to a run: reading, overrides, errors in the author's terms, solver and step."""
