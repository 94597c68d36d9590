"""Sound files, and the inputs of a render."""
