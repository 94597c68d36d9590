"""Loudness, spectrum, and the limiter."""
