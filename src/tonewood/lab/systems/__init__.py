"""The published systems: what was computed of them, against what, and their figures."""
