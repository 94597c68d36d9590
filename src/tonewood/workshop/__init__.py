"""What people do with instruments: fit measured bodies, compare, make and run listening tests."""
