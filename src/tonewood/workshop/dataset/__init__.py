"""Data sets: many renders with their labels, in shards."""
