"""Ridge and valley lines drawn on cloth by hand: what they are in scenes, runs and files."""
