"""The smoother: a calibration from a whole drive (doc/estimator.md, section 13)."""
