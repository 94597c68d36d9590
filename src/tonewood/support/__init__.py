"""Files, YAML, tables, units, plots: nothing of acoustics."""
