"""Servers for browsers: checks of requests, their bodies, their replies."""
