"""From a scene's file to a run: reading, overrides, errors at their lines (`validation_errors`), solver and step."""
