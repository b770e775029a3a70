"""What is said of a run at its end: made from what services counted, and shown to a person."""
