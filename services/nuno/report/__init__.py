"""What is said of a run at its end: made from what services counted, shown to a person, and what makes it doubtful."""
