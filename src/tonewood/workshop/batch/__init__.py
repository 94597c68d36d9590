"""Many renders at once, prepared for listeners."""
