"""Notes, scores, scales and their assignment to strings: plain data, without instruments."""
