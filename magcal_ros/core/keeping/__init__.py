"""Self-calibration while driving: candidates, their probation, the return to the old one."""
