"""Arrays only: modes, propagators, connections, and the kernel that steps them. No files, no YAML."""
