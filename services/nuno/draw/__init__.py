"""Drawing ridge and valley lines on cloth by hand: a page for a browser, served on loopback."""
