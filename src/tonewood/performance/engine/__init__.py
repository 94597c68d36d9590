"""Model, state and events in; blocks of sound out."""
