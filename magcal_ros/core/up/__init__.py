"""Where up is: propagated by the gyro, corrected by the accelerometer."""
