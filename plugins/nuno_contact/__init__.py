"""Bodies that cloth meets: shapes, skeletons, their motions, and penalty contact."""
