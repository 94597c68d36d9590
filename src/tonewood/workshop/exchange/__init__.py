"""Listening tests for other programs, and answers from them."""
