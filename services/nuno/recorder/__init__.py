"""The recorder service: writes the messages of a run to its recording."""
