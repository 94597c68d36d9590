"""Rendered and live sound: blocks, levels, files."""
