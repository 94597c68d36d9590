"""Notes, scores, scales and who plays what: plain data, nothing of instruments."""
