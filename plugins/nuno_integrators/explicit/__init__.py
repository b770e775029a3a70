"""Methods that find the next state from forces alone, by fixed steps or by their own."""
