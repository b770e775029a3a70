"""Steps of cloth by themselves: explicit ones, stiff ones, and the same by NumPy and SciPy."""
