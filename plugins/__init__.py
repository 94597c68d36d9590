"""The built-in plugins, found by their entry points, as a third party's are."""
