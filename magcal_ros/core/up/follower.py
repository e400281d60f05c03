"""Up at any stamp, from one IMU message after another."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit
from magcal_ros.core.geometry.vec3 import (
    Triple,
    between,
    distance,
    length,
    minus,
    propagated,
    scaled,
    unit_triple,
)
from magcal_ros.core.knowledge import CLEAR
from magcal_ros.core.samples.rest import GyroAtRest
from magcal_ros.core.samples.streams import STREAMS, SWAY, ImuSample, enclosing
from magcal_ros.core.samples.window import Window
from magcal_ros.core.up.filter import FILTER, PROPAGATION
from magcal_ros.core.up.propagation import GyroBias, GyroPropagation
from magcal_ros.core.up.stillness import ZERO, DeadAxes


def unseen_angles(time: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the variances of the angles between samples, radians², shape (n - 1, 3).

    A body may sway between samples that come slowly as much as from one to the next. If all they
    show is sway too fast for them, as random as white noise, the variance is right.

    `time` (n,) is in seconds, `rate` (n, 3) in rad/s.
    """
    step = np.diff(time)[:, None]
    square = np.zeros_like(rate)
    square[1:-1] = np.diff(rate, 2, axis=0) ** 2
    share = np.minimum(step / SWAY, 1.0) ** 4
    return np.asarray(share * step**2 * (square[:-1] + square[1:]) / 24.0)


def propagated_up(window: Window) -> FloatArray:
    """Return up at each sample, unit vectors in body axes, shape (n, 3).

    What the past and the future of a sample say of its up is averaged by their variances. A bias
    that is far beyond what is expected of a gyro holds for both as the whole past has shown it.
    """
    rate = window.angular_rate
    if rate is None or len(window) < 3:
        return unit(window.specific_force)
    past, known, bias = _followed(window, rate)
    if length(bias) > CLEAR * FILTER.bias_sigma:
        # Before it was known, up was wrong by more than its variance.
        rate = rate - bias
        past, known, _ = _followed(window, rate)
    future, known_later, _ = _followed(window, rate, backwards=True)
    return unit(past / known + (future / known_later)[::-1])


def _followed(
    window: Window, rate: FloatArray, backwards: bool = False
) -> tuple[FloatArray, FloatArray, Triple]:
    """Return up (n, 3) and its variance (n, 1) as the past of each sample gives it; the bias."""
    way = -1 if backwards else 1
    follower = UpFollower()
    found: list[Up] = []
    columns = (
        values[::way].tolist()
        for values in (way * window.time, window.field, window.specific_force, way * rate)
    )
    for stamp, m, f, w in zip(*columns, strict=True):
        follower.add_field(stamp, tuple(m))
        follower.add(ImuSample(stamp, tuple(f), tuple(w)))
        up = follower.at(stamp, 0.0)
        assert up is not None
        found.append(up)
    variances = np.array([[each.variance] for each in found])
    return np.array([each.direction for each in found]), variances, follower.gyro_bias.rate


class Levelling:
    """Smooths the direction of the specific force.

    It begins with a force over gravity that is not zero; `up` is a unit vector, body axes.
    """

    def __init__(self, force: Triple) -> None:
        self.up = unit_triple(force)
        self._mean = self.up
        self._scatter = 0.0
        self._size = self._rest = length(force)
        self._seconds = 0.0

    def add(self, force: Triple, seconds: float) -> None:
        """Take the next reading, so many seconds after the one before."""
        seen = unit_triple(force)
        up = between(self.up, seen, 1.0 - math.exp(-seconds / PROPAGATION.smoothing))
        self.up = unit_triple(up) if length(up) > 0.0 else seen
        self._seconds += seconds
        memory = 1.0 - math.exp(-seconds / PROPAGATION.memory)
        self._mean = between(self._mean, self.up, memory)
        away = distance(self.up, self._mean)
        self._scatter += memory * (0.5 * away * away - self._scatter)
        size = length(force)
        self._size += memory * (size - self._size)
        self._rest += (
            seconds / min(self._seconds + seconds, PROPAGATION.rest_memory) * (size - self._rest)
        )

    @property
    def variance(self) -> float:
        """Variance of up in either direction, rad².

        Up that scatters is not known better than that, and an acceleration of p g across up
        stretches the accelerometer by p²/2.
        """
        stretch = max(0.0, abs(self._size / self._rest - 1.0) - PROPAGATION.smallest)
        return FILTER.floor**2 + self._scatter + stretch


SMALLEST_FORCE, LARGEST_FORCE = 0.1, 500.0
"""m/s². Outside, in free fall or a fault of the driver, a reading has no direction."""
LARGEST_RATE = 100.0  # rad/s, three times what any gyro measures


class Up(NamedTuple):
    """Up in body axes, a unit vector, and its variance in either direction, rad²."""

    direction: Triple
    variance: float


class UpFollower:
    """Follows up through whatever the robot does.

    With a gyro up is propagated by it and corrected by the accelerometer as far as the motion
    allows; without one, or with one that has dead axes or turns otherwise than the accelerometer,
    the latter is smoothed.
    """

    def __init__(self) -> None:
        self._propagation = GyroPropagation()
        self._dead_axes = DeadAxes()
        self._levelling: Levelling | None = None
        self._last: ImuSample | None = None
        self._ups: deque[tuple[float, Triple, float]] = deque(maxlen=STREAMS.remembered)

    @property
    def is_propagated(self) -> bool:
        """Whether the gyro propagates up; false without one, and while it is not believed."""
        return self._levelling is None and self._last is not None

    @property
    def gyro_is_believed(self) -> bool:
        """Whether the gyro, where there is one, turns as the accelerometer does."""
        return self._propagation.check.is_believed

    @property
    def gyro_is_whole(self) -> bool:
        """Whether all axes of the gyro, where there is one, are alive."""
        return not self._dead_axes.is_any

    @property
    def rate(self) -> Triple:
        """The newest turn rate less the gyro's bias, rad/s; zero where up is not propagated."""
        return self._propagation.rate if self.is_propagated else ZERO

    @property
    def mean_rate(self) -> Triple:
        """The same as the mean since the message before."""
        return self._propagation.mean_rate if self.is_propagated else ZERO

    @property
    def gyro_bias(self) -> GyroBias:
        """What is known of the gyro's bias."""
        return self._propagation.gyro_bias

    @property
    def gyro_at_rest(self) -> GyroAtRest | None:
        """The same where a rest has shown it; None before any."""
        bias = self.gyro_bias
        sigma = math.sqrt(bias.variance)
        if sigma > FILTER.seen_at_rest or not self.is_propagated:
            return None
        return GyroAtRest(bias.rate, sigma)

    @property
    def is_at_rest(self) -> bool:
        """Whether the robot stands, or rolls on so evenly that no sensor shows the difference."""
        return self.is_propagated and self._propagation.is_settled

    @property
    def newest(self) -> Triple | None:
        """Up after the newest sample, unit, body axes; None before the first."""
        return self._ups[-1][1] if self._ups else None

    @property
    def newest_stamp(self) -> float:
        """Of the newest sample, seconds; minus infinity before the first."""
        return self._ups[-1][0] if self._ups else -math.inf

    def add_field(self, stamp: float, field: Triple) -> None:
        """Take a raw field sample: whether it turns separates a slow turn from a gyro's bias.

        The stamp is on the clock of the IMU, seconds; the field may be in any unit, calibrated or
        not.
        """
        self._propagation.field.add(stamp, field)

    def add(self, sample: ImuSample, linear_acceleration: Triple | None = None) -> None:
        """Take the next IMU sample; one that does not follow the last starts anew.

        `linear_acceleration` (m/s², body axes) is that of the robot itself, where it is measured,
        as from a speed v it is (dv/dt, v w_z, 0). It is subtracted from the specific force.
        """
        if not SMALLEST_FORCE < length(sample.force) < LARGEST_FORCE:
            return
        last, self._last = self._last, sample
        seconds = math.inf if last is None else sample.stamp - last.stamp
        is_given = linear_acceleration is not None
        felt = minus(sample.force, linear_acceleration or ZERO)
        force = scaled(felt, 1.0 / STANDARD_GRAVITY)
        if seconds <= 0.0:
            self._ups.clear()
        follows = last is not None and 0.0 < seconds <= STREAMS.longest_gyro_step
        stamp, rate, propagation = sample.stamp, sample.rate, self._propagation
        if has_gyro(sample):
            self._dead_axes.add(rate)
            if follows and last is not None and has_gyro(last):
                propagation.add(stamp, force, rate, seconds, is_given)
            else:
                propagation.begin(stamp, force, rate, is_given)
        if has_gyro(sample) and propagation.check.is_believed and self.gyro_is_whole:
            if self._levelling is not None:
                self._levelling = None
                propagation.begin(stamp, force, rate, is_given)
        elif self._levelling is not None and follows:
            self._levelling.add(force, seconds)
        else:
            self._levelling = Levelling(force)
        now = propagation if self._levelling is None else self._levelling
        self._ups.append((stamp, now.up, now.variance))

    def at(self, stamp: float, max_gap: float) -> Up | None:
        """Return up at a stamp; None if no IMU sample is near enough.

        Before the newest sample up is interpolated, after it the body is taken to turn on as it
        does. `max_gap` are the seconds between samples that are interpolated between, and after the
        newest.
        """
        found = enclosing(self._ups, stamp)
        if found is None:
            return None
        (begin, up, variance), after = found
        since = stamp - begin
        if since > 0.0:
            span = since if after is None else after[0] - begin
            if span > max_gap:
                return None
            if after is None:
                up = propagated(up, scaled(self.rate, since))
            else:
                up = between(up, after[1], since / span)
        return Up(unit_triple(up), variance) if length(up) > 0.0 else None


def has_gyro(sample: ImuSample) -> bool:
    """Whether a sample carries a turn rate: a possible one, and not a field that was left empty."""
    return 0.0 < length(sample.rate) < LARGEST_RATE
