"""Energy stored, lost and put in over the steps of a motion, computed from the motion alone."""
