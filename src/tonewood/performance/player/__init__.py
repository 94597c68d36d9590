"""Notes and controllers become changes of strings and gestures on a timeline."""
