"""How bodies' frames move within a frame of animation, and vertices that they carry; contact is a plugin."""
