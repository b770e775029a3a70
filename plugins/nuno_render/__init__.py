"""Pictures without a screen or a GPU: the renderer `raster`."""
