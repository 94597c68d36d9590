"""Time that accuracy costs: this project and the methods of the literature on the same systems."""
