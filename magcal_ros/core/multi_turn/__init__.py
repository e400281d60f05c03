"""Several turns on different tilts, joined into one estimate of the full correction."""
