"""Up at any stamp, from successive IMU messages."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from magcal_ros.core.calibration.calibration import FittedGyroBias
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit, wrapped
from magcal_ros.core.geometry.vec3 import (
    Triple,
    distance,
    dot,
    interpolate,
    length,
    minus,
    plus,
    propagated,
    scaled,
    unit_triple,
)
from magcal_ros.core.knowledge import CLEAR
from magcal_ros.core.samples.rest import GyroAtRest
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import ImuSample, enclosing
from magcal_ros.core.samples.window import Window
from magcal_ros.core.up.filter import FILTER, PROPAGATION
from magcal_ros.core.up.propagation import GyroBias, GyroPropagation, LinearAcceleration
from magcal_ros.core.up.stillness import ZERO, GyroAxes


def propagated_up(window: Window) -> FloatArray:
    """Return up at each sample, unit vectors in body axes, shape (n, 3).

    The estimates from the past and from the future of a sample are averaged by their variances. If
    the bias is far larger than expected, its estimate from all samples is subtracted before.
    """
    rate = window.angular_rate
    if rate is None or len(window) < 3:
        return unit(window.specific_force)
    past, known, bias = _followed(window, rate)
    if length(bias) > CLEAR * FILTER.bias_sigma:
        # Before the bias was known, the error of up exceeded its sigma.
        rate = rate - bias
        past, known, _ = _followed(window, rate)
    future, known_later, _ = _followed(window, rate, backwards=True)
    return unit(past / known + (future / known_later)[::-1])


def _followed(
    window: Window, rate: FloatArray, backwards: bool = False
) -> tuple[FloatArray, FloatArray, Triple]:
    """Return up (n, 3) and its variance (n, 1) from the past of each sample, and the last bias."""
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
        # A shock, a fall or milli-g published as m/s² is not followed.
        up = follower.at(stamp, 0.0)
        found.append(up or Up(follower.newest or unit_triple(tuple(f)), UNKNOWN))
    variances = np.array([[each.variance] for each in found])
    return np.array([each.direction for each in found]), variances, follower.gyro_bias.rate


class Levelling:
    """Smooths the direction of the specific force (g).

    The first force is not zero; `up` is a unit vector, body axes.
    """

    def __init__(self, force: Triple) -> None:
        self.up = unit_triple(force)
        self._mean = self.up
        self._scatter = 0.0
        self._size = self._rest = length(force)
        self._seconds = 0.0

    def add(self, force: Triple, seconds: float) -> None:
        """Add a reading, `seconds` after the previous one."""
        seen = unit_triple(force)
        up = interpolate(self.up, seen, 1.0 - math.exp(-seconds / PROPAGATION.smoothing))
        self.up = unit_triple(up) if length(up) > 0.0 else seen
        self._seconds += seconds
        memory = 1.0 - math.exp(-seconds / PROPAGATION.memory)
        self._mean = interpolate(self._mean, self.up, memory)
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

        It includes the scatter of up. An acceleration of p g across up lengthens the force by p²/2.
        """
        segment = max(0.0, abs(self._size / self._rest - 1.0) - PROPAGATION.smallest)
        return FILTER.floor**2 + self._scatter + segment


SMALLEST_FORCE, LARGEST_FORCE = 0.1, 500.0
"""m/s². Outside, in free fall or a fault of the driver, a reading has no direction."""
UNKNOWN = 1.0  # rad², the variance of an up that no reading shows
LARGEST_RATE = 100.0  # rad/s, three times what any gyro measures


class Up(NamedTuple):
    """Up in body axes, a unit vector, and its variance in either direction, rad²."""

    direction: Triple
    variance: float


class _UpRecord(NamedTuple):
    """Up at a stamp (s), and the sum of the body's turns until then."""

    stamp: float
    up: Triple
    variance: float
    turns: Triple  # rotation vectors by the gyro without its bias, radians, body axes


class UpFollower:
    """Estimates up during any motion.

    The gyro propagates up, and the accelerometer corrects it as far as the motion allows. A gyro
    that measures the turn about up alone does so, too, with a tilt that changes slowly as roads do.
    Without a gyro, or if it disagrees with the accelerometer, the specific force is smoothed
    instead.
    """

    def __init__(self) -> None:
        self._propagation = GyroPropagation()
        self._axes = GyroAxes()
        self._levelling: Levelling | None = None
        self._last: ImuSample | None = None
        self.turned = 0.0
        """Turn about up by the gyro, radians, without rests and what the bias may explain."""
        self.turned_unmeasured = 0.0
        """Largest turn of the compass against the gyro while the gyro repeats its rate, radians."""
        self._compass = math.nan, math.nan  # stamp, s, and newest yaw, radians
        self._unmeasured = 0.0
        self._turns = self._field = ZERO
        self._ups: deque[_UpRecord] = deque(maxlen=STREAMS.remembered)

    @property
    def is_propagated(self) -> bool:
        """Whether the gyro propagates up; false without a usable gyro."""
        return self._levelling is None and self._last is not None

    @property
    def gyro_is_consistent(self) -> bool:
        """Whether the gyro, if any, agrees with the accelerometer."""
        return self._propagation.check.is_consistent

    @property
    def gyro_is_whole(self) -> bool:
        """Whether no axis of the gyro, if any, is dead."""
        return not self._axes.are_dead

    @property
    def rate(self) -> Triple | None:
        """The newest turn rate minus the gyro's bias, rad/s; None if up is not propagated."""
        return self._propagation.rate if self.is_propagated else None

    @property
    def rate_is_old(self) -> bool:
        """Whether the gyro has repeated its rate about up for longer than it may be silent."""
        x, y, z = map(abs, self.newest or ZERO)
        axis = (x, y, z).index(max(x, y, z))
        return self.newest_stamp - self._axes.changed[axis] > STREAMS.longest_gyro_step

    @property
    def mean_rate(self) -> Triple:
        """Its mean since the previous message; zero if up is not propagated."""
        return self._propagation.mean_rate if self.is_propagated else ZERO

    @property
    def gyro_bias(self) -> GyroBias:
        """The estimate of the gyro's bias."""
        return self._propagation.gyro_bias

    @property
    def gyro_at_rest(self) -> GyroAtRest | None:
        """The same, from a rest; None before the first rest, or if axes are dead."""
        bias = self.gyro_bias
        sigma = math.sqrt(bias.variance)
        if sigma > FILTER.seen_at_rest or not self.is_propagated or not self.gyro_is_whole:
            return None
        return GyroAtRest(bias.rate, sigma)

    @property
    def is_at_rest(self) -> bool:
        """Whether the robot rests, or moves so steadily that no sensor shows the difference."""
        return self.is_propagated and self._propagation.is_settled

    @property
    def newest(self) -> Triple | None:
        """Up after the newest sample, unit, body axes; None before the first."""
        return self._ups[-1].up if self._ups else None

    @property
    def newest_stamp(self) -> float:
        """Stamp of the newest sample, seconds; minus infinity before the first."""
        return self._ups[-1].stamp if self._ups else -math.inf

    def add_field(self, stamp: float, field: Triple) -> None:
        """Add a raw field sample, whose rotation separates a slow turn from a gyro bias.

        The stamp is on the clock of the IMU, seconds; the field may be in any unit, calibrated or
        not. Once the bias is known, a repeated value is left out: it is more likely that the
        magnetometer is frozen or coarse than that the bias has jumped.
        """
        if field != self._field or self.gyro_at_rest is None:
            self._propagation.field.add(stamp, field)
        self._field = field

    def add(self, sample: ImuSample, measured: LinearAcceleration | None = None) -> None:
        """Add an IMU sample; after a gap the estimate starts again.

        A measured acceleration corrects up as long as the gyro propagates it.
        """
        if not SMALLEST_FORCE < length(sample.force) < LARGEST_FORCE:
            return
        last, self._last = self._last, sample
        seconds = math.inf if last is None else sample.stamp - last.stamp
        force = scaled(sample.force, 1.0 / STANDARD_GRAVITY)
        if seconds <= 0.0:
            self._ups.clear()
        follows = last is not None and 0.0 < seconds <= STREAMS.longest_gyro_step
        stamp, propagation = sample.stamp, self._propagation
        was_hidden, rate = propagation.tilt_is_hidden, self._whole_rate(sample, force)
        propagation.tilt_is_hidden = not self.gyro_is_whole
        # Until dead axes are detected, up is rotated wrongly, so it starts again.
        follows = follows and propagation.tilt_is_hidden is was_hidden
        if rate is not None:
            if follows and last is not None and self._has_gyro(last):
                propagation.add(stamp, force, rate, seconds, measured)
            else:
                propagation.begin(stamp, force, rate)
        if rate is not None and propagation.check.is_consistent:
            if self._levelling is not None:
                self._levelling = None
                propagation.begin(stamp, force, rate)
        elif self._levelling is not None and follows:
            self._levelling.add(force, seconds)
        else:
            self._levelling = Levelling(force)
        now = propagation if self._levelling is None else self._levelling
        if follows and self.is_propagated:
            self._count_turn(seconds, now.up)
        self._ups.append(_UpRecord(stamp, now.up, now.variance, self._turns))

    def _count_turn(self, seconds: float, up: Triple) -> None:
        self._turns = plus(self._turns, scaled(self.mean_rate, seconds))
        if not self.is_at_rest:
            rate = dot(self.mean_rate, up)
            sure = max(0.0, abs(rate) - math.sqrt(self.gyro_bias.variance))
            self.turned += math.copysign(sure * seconds, rate)

    def add_yaw(self, stamp: float, yaw: float) -> None:
        """Take a yaw of the compass, ENU, radians: it shows whether the gyro is frozen."""
        (before, old), self._compass = self._compass, (stamp, yaw)
        last, up = self._last, self.newest
        is_old = last is not None and self._has_gyro(last) and self.rate_is_old
        if up is None or math.isnan(old) or not is_old:
            self._unmeasured = self.turned_unmeasured = 0.0
            return
        measured = dot(self.turn_between(before, stamp), up)
        self._unmeasured += wrapped(yaw - old - measured)
        self.turned_unmeasured = max(self.turned_unmeasured, abs(self._unmeasured))

    def take_bias(self, fitted: FittedGyroBias) -> None:
        """Use the gyro's bias as the fit of a calibration found it.

        In a steady circle, an unknown bias makes the estimated up lean. The accelerometer alone
        cannot separate this lean from the centripetal acceleration; a fit with the field can.
        """
        if self.is_propagated:
            self._propagation.take_bias(fitted)

    def _whole_rate(self, sample: ImuSample, force: Triple) -> Triple | None:
        """Return the rate of a sample, None without one; if axes are dead, that about up."""
        if not self._has_gyro(sample):
            return None
        self._axes.add(sample.stamp, sample.rate)
        if self.gyro_is_whole:
            return sample.rate
        return self._axes.rate_about_up(sample.rate, self.newest or force)

    def _has_gyro(self, sample: ImuSample) -> bool:
        """Whether a sample has a possible turn rate, and not an empty field of the message.

        Zeros are a rate if there were others before: a coarse gyro without a bias shows them at
        rest.
        """
        size = length(sample.rate)
        return size < LARGEST_RATE and (size > 0.0 or math.isfinite(max(self._axes.changed)))

    def at(self, stamp: float, max_gap: float) -> Up | None:
        """Return up at a stamp; None if no IMU sample is near enough.

        Up is interpolated before the newest sample, and propagated at the same rate after it.
        `max_gap`, seconds, is the longest time between samples, and after the newest one.
        """
        found = self._record_at(stamp, max_gap)
        if found is None or not length(found.up) > 0.0:
            return None
        return Up(unit_triple(found.up), found.variance)

    def turn_between(self, start: float, end: float) -> Triple:
        """Return the rotation vector of the body between two near stamps, radians, body axes.

        By the gyro without its bias, constant after the newest sample; zero where it is unknown.
        """
        before, after = self._record_at(start), self._record_at(end)
        return ZERO if before is None or after is None else minus(after.turns, before.turns)

    def _record_at(self, stamp: float, max_gap: float = math.inf) -> _UpRecord | None:
        found = enclosing(self._ups, stamp)
        if found is None:
            return None
        (begin, up, variance, turns), after = found
        since = stamp - begin
        span = since if after is None else after.stamp - begin
        if since > 0.0:
            if span > max_gap:
                return None
            if after is None:
                turn = scaled(self.rate or ZERO, since)
                up, turns = propagated(up, turn), plus(turns, turn)
            else:
                up = interpolate(up, after.up, since / span)
                turns = interpolate(turns, after.turns, since / span)
        return _UpRecord(stamp, up, variance, turns)
