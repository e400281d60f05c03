"""Whether the calibration in force still holds."""
