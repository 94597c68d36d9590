"""The built-in instruments: folders with an instrument.yaml and its tables."""
