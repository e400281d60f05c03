"""Joint maximum likelihood over accelerometer, magnetometer and, where present, gyro."""

from magcal_ros.core.methods.maximum_likelihood.driver import METHOD, Options, fit

__all__ = ["METHOD", "Options", "fit"]
