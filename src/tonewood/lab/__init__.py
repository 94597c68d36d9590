"""The published systems, the methods they are compared with, and what accuracy costs."""
