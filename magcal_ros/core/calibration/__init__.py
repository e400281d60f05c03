"""What a calibration is: the correction, how sure it is, what speaks for it."""
