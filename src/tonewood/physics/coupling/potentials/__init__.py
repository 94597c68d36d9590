"""Potentials of modal coordinates: what they are, those that come with tonewood, and their solution step by step."""
