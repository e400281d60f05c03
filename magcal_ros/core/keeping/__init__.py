"""Self-calibration while driving: candidates, their probation, the return to an old calibration."""
