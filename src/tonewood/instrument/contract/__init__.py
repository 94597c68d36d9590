"""The plugin contract: base classes of plugins, the types that they return, and the registry of those installed."""
