"""Up at any stamp, from one IMU message after another."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from magcal_ros.core.attitude import STANDARD_GRAVITY
from magcal_ros.core.streams import HISTORY, LONGEST_CARRY, ImuSample
from magcal_ros.core.triples import Triple, between, carried, length, unit_triple
from magcal_ros.core.up.carrier import ZERO, Carrier
from magcal_ros.core.up.levelling import Levelling

SMALLEST_FORCE, LARGEST_FORCE = 0.1, 500.0
"""m/s². Outside, in free fall or a fault of the driver, a reading tells no direction."""
LARGEST_RATE = 100.0
"""rad/s, three times what any gyro measures."""


class Up(NamedTuple):
    """Up in body axes, a unit vector, and its variance in either direction, rad²."""

    direction: Triple
    variance: float


class UpFollower:
    """Follows up through whatever the robot does.

    With a gyro up is carried by it and corrected by the accelerometer as far as the motion allows;
    without one, or with one that turns otherwise than the accelerometer, the latter is smoothed.
    """

    def __init__(self) -> None:
        self._carrier = Carrier()
        self._levelling: Levelling | None = None
        self._last: ImuSample | None = None
        self._ups: deque[tuple[float, Triple, float]] = deque(maxlen=HISTORY)

    @property
    def is_carried(self) -> bool:
        """Whether the gyro carries up; false without one, and while it is not believed."""
        return self._levelling is None and self._last is not None

    @property
    def gyro_is_believed(self) -> bool:
        """Whether the gyro, where there is one, turns as the accelerometer does."""
        return self._carrier.check.is_believed

    @property
    def rate(self) -> Triple:
        """The newest turn rate less the gyro's bias, rad/s; zero where up is not carried."""
        return self._carrier.rate if self.is_carried else ZERO

    @property
    def mean_rate(self) -> Triple:
        """The same as the mean since the message before."""
        return self._carrier.mean_rate if self.is_carried else ZERO

    def add(self, sample: ImuSample) -> None:
        """Take the next IMU sample; one that does not follow the last starts anew."""
        if not SMALLEST_FORCE < length(sample.force) < LARGEST_FORCE:
            return
        last, self._last = self._last, sample
        seconds = math.inf if last is None else sample.stamp - last.stamp
        x, y, z = sample.force
        force = (x / STANDARD_GRAVITY, y / STANDARD_GRAVITY, z / STANDARD_GRAVITY)
        if seconds <= 0.0:
            self._ups.clear()
        follows = last is not None and 0.0 < seconds <= LONGEST_CARRY
        if has_gyro(sample):
            if follows and last is not None and has_gyro(last):
                self._carrier.add(force, sample.rate, seconds)
            else:
                self._carrier.begin(force, sample.rate)
        if has_gyro(sample) and self._carrier.check.is_believed:
            if self._levelling is not None:
                self._levelling = None
                self._carrier.begin(force, sample.rate)
        elif self._levelling is not None and follows:
            self._levelling.add(force, seconds)
        else:
            self._levelling = Levelling(force)
        self._note(sample.stamp)

    def at(self, stamp: float, max_gap: float) -> Up | None:
        """Return up at a stamp; None if no IMU sample is near enough.

        Parameters
        ----------
        stamp : float
            Seconds. Before the newest sample up is interpolated, after it the body is taken to
            turn on as it does.
        max_gap : float
            Seconds between samples that are interpolated between, and after the newest.
        """
        after = None
        for moment in reversed(self._ups):
            since = stamp - moment[0]
            if since >= 0.0:
                return self._beside(moment, after, since, max_gap)
            after = moment
        return None

    def _beside(
        self,
        before: tuple[float, Triple, float],
        after: tuple[float, Triple, float] | None,
        since: float,
        max_gap: float,
    ) -> Up | None:
        stamp, up, variance = before
        if since > 0.0:
            span = since if after is None else after[0] - stamp
            if span > max_gap:
                return None
            if after is None:
                x, y, z = self.rate
                up = carried(up, (x * since, y * since, z * since))
            else:
                up = between(up, after[1], since / span)
        return Up(unit_triple(up), variance) if length(up) > 0.0 else None

    def _note(self, stamp: float) -> None:
        if self._levelling is None:
            self._ups.append((stamp, self._carrier.up, self._carrier.variance))
        else:
            self._ups.append((stamp, self._levelling.up, self._levelling.variance))


def has_gyro(sample: ImuSample) -> bool:
    """Whether a sample carries a turn rate: a possible one, and not a field nobody filled."""
    return 0.0 < length(sample.rate) < LARGEST_RATE
