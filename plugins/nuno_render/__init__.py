"""Pictures without a screen or a GPU: the renderer `raster`, and pictures of yarns by rays."""
