"""Whether a body given by modes can create energy, and the nearest one that cannot."""
