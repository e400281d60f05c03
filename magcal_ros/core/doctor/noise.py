"""How much the sensors' numbers scatter from sample to sample, while they move or not."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.doctor.finding import Finding, looked_at
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.sensor_log import SensorLog


@dataclass(frozen=True)
class NoiseTuning:
    """From which standard deviation per axis and sample noise is worth a look."""

    field: float = 3e-6
    """Tesla."""
    rate: float = 0.3
    """rad/s; an engine shakes a good gyro by a tenth."""


TUNING = NoiseTuning()


def white_noise(values: FloatArray) -> FloatArray:
    """Return the standard deviation of each column (n, d) about a smooth course.

    Second differences of white noise have six times its variance, and nearly nothing of a slow
    movement.
    """
    second = values[2:] - 2.0 * values[1:-1] + values[:-2]
    return np.asarray(1.4826 * np.median(np.abs(second), axis=0) / math.sqrt(6.0))


def noise_findings(log: SensorLog, factor: float = 1.0) -> list[Finding]:
    """Look at the scatter of both sensors; each stream has three samples or more.

    Parameters
    ----------
    log : SensorLog
        The cleaned streams.
    factor : float
        What makes rad/s of the gyro's numbers.
    """
    field = float(white_noise(log.field).max())
    words = (
        "the field is noisy: average in the driver, and move the sensor away from motors and their "
        "wires"
    )
    evidence = f"{field * 1e6:.2f} µT per sample"
    found = [looked_at("field_noise", "field: noise", evidence, words * (field > TUNING.field))]
    if log.has_gyro:
        rate = factor * float(white_noise(log.rate).max())
        force = float(white_noise(log.force).max())
        words = "the gyro is noisy: look at its range, its low-pass filter and how it is mounted"
        evidence = f"gyro {math.degrees(rate):.2f} °/s, accelerometer {force:.3f} m/s² per sample"
        found.append(looked_at("imu_noise", "IMU: noise", evidence, words * (rate > TUNING.rate)))
    return found
