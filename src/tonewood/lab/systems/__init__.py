"""The published systems: quantities computed of them, their references, and their figures."""
