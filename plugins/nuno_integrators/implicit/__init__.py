"""Methods that solve for the next state by Newton's method, with the linear algebra that takes."""
