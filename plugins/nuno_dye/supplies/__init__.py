"""What is given to a cloth and what keeps dye out of it, and the regions of both."""
