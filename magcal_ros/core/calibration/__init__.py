"""A calibration: the correction, its covariance, the evidence for it."""
