"""Operations that bind vertices to bodies, and release them, during a simulation."""
