"""Bodies and contact: shapes, skeletons and their motions; penalty, sliding and cloth contact."""
