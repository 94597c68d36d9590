"""Parts of a score on instruments of their own: chosen by program, rendered, mixed."""
