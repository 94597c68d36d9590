"""How components act on one another: connections, their laws, rising tension, and the system they make."""
