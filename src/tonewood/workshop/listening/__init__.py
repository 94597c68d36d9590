"""Listening tests in a browser: pages served to listeners, their answers, and the analysis of these."""
