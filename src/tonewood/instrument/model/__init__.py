"""An instrument assembled for one sampling rate: strings, tuning, outputs."""
