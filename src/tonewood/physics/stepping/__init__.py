"""A compiled system in time: known forces, the scheme in NumPy, and the same scheme in C++."""
