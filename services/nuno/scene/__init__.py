"""From a scene's file to what will run: reading, replaced fields, errors in its author's words, solver and step."""
