"""The shapes of bodies, each a plugin. Their motions are in `motions`, their contact in `penalty` and `sliding`."""
