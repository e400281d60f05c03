"""How a calibration keeps itself: candidates from driving, their probation, the way back."""
