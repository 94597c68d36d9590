"""Components by their modes: bases, the exact flow of modes over a step, strings as modes. Arrays only."""
