"""A rectangular plate as a body for tonewood, and an instrument that uses it."""
