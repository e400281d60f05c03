"""The estimator: joint maximum likelihood over accelerometer, magnetometer and gyro."""
