"""tonewood: plugin-based physical sound synthesis."""
