"""Pages of the documentation's reference that are made from what they describe, as Markdown: `nuno schema`."""
