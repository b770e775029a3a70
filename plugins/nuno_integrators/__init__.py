"""Methods that advance cloth in time: explicit, implicit and XPBD; the forces that they take are no part of it."""
