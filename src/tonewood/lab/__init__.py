"""The published systems, the methods they are compared with, and the cost of accuracy."""
