"""What accuracy costs in time: this project and the methods of the literature on the same systems."""
