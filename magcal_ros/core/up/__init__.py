"""The direction of up: propagated by the gyro, corrected by the accelerometer."""
