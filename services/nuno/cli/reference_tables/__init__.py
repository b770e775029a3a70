"""Reference pages of the documentation, generated from the code as Markdown: `nuno schema`."""
