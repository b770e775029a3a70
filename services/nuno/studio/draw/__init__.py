"""Ridge and valley lines drawn on cloth by hand, for scenes, runs and files."""
