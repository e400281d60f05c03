"""Several turns at different tilts, joined into one estimate of the full correction."""
