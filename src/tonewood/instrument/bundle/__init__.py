"""A bundle: its schema and how it is read, made, changed and migrated."""
