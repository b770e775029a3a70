"""Security of a bus across hosts: certificates of roles, and their rights."""
