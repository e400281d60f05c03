"""Joint maximum likelihood over accelerometer, magnetometer and, where present, gyro."""

from magcal_ros.core.methods.maximum_likelihood.fit import Options, fit
from magcal_ros.core.methods.maximum_likelihood.report import METHOD

__all__ = ["METHOD", "Options", "fit"]
