"""Up while a robot drives in circles: carried by the gyro, corrected by the accelerometer."""

from __future__ import annotations

import math

from magcal_ros.core.streams import ImuSample

SLOWEST_TURN = 0.05
"""rad/s. Turning more slowly than this nothing pulls sideways, and the accelerometer is right."""

QUICK = 0.15
"""Seconds of smoothing while the accelerometer is right."""

TURN_SHARE = 3.0
"""Radians of turn over which the accelerometer corrects the gyro: a pull to the outside turns
with the robot, and over half a circle and more it cancels."""

LONGEST_GAP = 0.5
"""Seconds without a sample after which the gyro's path is lost."""

Triple = tuple[float, float, float]


class CarriedGravity:
    """Follows up through a turn; plain floats, because every IMU message passes here."""

    def __init__(self) -> None:
        self.up: Triple | None = None
        self._last: ImuSample | None = None

    def add(self, sample: ImuSample) -> None:
        """Take the next IMU sample; without a gyro there is no up to carry."""
        last, self._last = self._last, sample
        if not all(map(math.isfinite, sample.rate)):
            self.up = None
            return
        seen = _unit(sample.force)
        step = math.inf if last is None else sample.stamp - last.stamp
        if self.up is None or last is None or not 0.0 < step <= LONGEST_GAP:
            self.up = seen
            return
        x, y, z = self.up
        p, q, r = (0.5 * (a + b) * step for a, b in zip(sample.rate, last.rate, strict=True))
        # A direction fixed in the world turns in the body by u x w dt.
        x, y, z = x + y * r - z * q, y + z * p - x * r, z + x * q - y * p
        share = min(1.0, step / _reach(sample.rate))
        self.up = _unit(
            (x + share * (seen[0] - x), y + share * (seen[1] - y), z + share * (seen[2] - z))
        )


def _reach(rate: Triple) -> float:
    """Return the seconds over which the accelerometer corrects the gyro."""
    speed = math.sqrt(rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2)
    return TURN_SHARE / speed if speed > SLOWEST_TURN else QUICK


def _unit(vector: Triple) -> Triple:
    x, y, z = vector
    size = math.sqrt(x * x + y * y + z * z)
    return (x / size, y / size, z / size)
