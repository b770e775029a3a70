"""Methods that solve for the next state by Newton's method, and their linear algebra."""
