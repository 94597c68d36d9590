"""Facts of one instrument or several, as plain data, as JSON, and as one HTML page."""
