"""Coupling of components: connections, their laws, tension modulation, and the system of all."""
