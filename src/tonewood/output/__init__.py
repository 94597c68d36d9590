"""Sound files, rendering and live playing."""
