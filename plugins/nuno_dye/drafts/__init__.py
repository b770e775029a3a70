"""How yarns cross: weaves, and drafts from Weaving Information Files."""
