"""Cleans the two raw streams, counts dropped samples by reason, and pairs samples by stamp."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple, TypeVar

import numpy as np

from magcal_ros.core.geometry.arrays import accumulated
from magcal_ros.core.geometry.vec3 import Triple, dot, interpolate, length, scaled
from magcal_ros.core.samples.bursts import bursts_in_words
from magcal_ros.core.samples.samples_tuning import BURSTS, STREAMS

Stamped = TypeVar("Stamped", bound=tuple[object, ...])
SWAY = 0.22
"""About half a period of the fastest sway of a body, 2 Hz, seconds: slower samples miss it."""


class DropReason(str, Enum):
    """Why a sample was not used."""

    NOT_FINITE = "not_finite"
    ZERO = "zero"
    TOO_LARGE = "too_large"
    ABSENT = "absent"
    ZERO_STAMP = "zero_stamp"
    BACKWARD_STAMP = "backward_stamp"
    REPEATED = "repeated"
    UNPAIRED = "unpaired"
    UNREADABLE = "unreadable"


class ImuSample(NamedTuple):
    """Specific force (m/s²) and angular rate (rad/s, NaN without a gyro) at a stamp (s)."""

    stamp: float
    force: Triple
    rate: Triple
    orientation: tuple[float, float, float, float] | None = None
    """By the driver, a quaternion x, y, z, w; only `magcal doctor` uses it."""
    is_measured: bool = True  # false if a reader has interpolated the sample


class FieldSample(NamedTuple):
    """Raw field (tesla) at a stamp (s)."""

    stamp: float
    field: Triple


class ImuSpan(NamedTuple):
    """Integrals over all IMU samples from one pair to the next."""

    angle: Triple  # rotation vector in body axes, rad
    velocity: Triple  # of the specific force in body axes, m/s
    intervals: int  # between the samples, both ends included


class Pair(NamedTuple):
    """A field sample with the IMU interpolated at its stamp."""

    field: FieldSample
    imu: ImuSample
    span: ImuSpan | None = None
    """Since the previous pair; None for the first one, and if IMU samples are missing."""


class StampGuard:
    """Accepts increasing stamps only, until time is set back for good.

    `newest` is in seconds, minus infinity before the first.
    """

    def __init__(self) -> None:
        self.newest = -math.inf
        self._gaps: deque[float] = deque(maxlen=BURSTS.watched)
        self._backward = 0

    def check(self, stamp: float) -> DropReason | None:
        """Return why a stamp is refused, or None and remember it as the newest."""
        if stamp <= 0.0 or not math.isfinite(stamp):
            return DropReason.ZERO_STAMP
        if stamp == self.newest:
            return DropReason.REPEATED
        if stamp < self.newest:
            self._backward += 1
            if self._backward < STREAMS.restart_after:
                return DropReason.BACKWARD_STAMP
        self._backward = 0
        if -math.inf < self.newest < stamp:
            self._gaps.append(stamp - self.newest)
        self.newest = stamp
        return None

    @property
    def bursts_in_words(self) -> str:
        """A warning with a remedy if the stamps come in harmful bursts; else empty."""
        return bursts_in_words(accumulated(np.array(self._gaps)), BURSTS.harmful)


class Streams:
    """The newest samples of IMU and field, cleaned, and the IMU at any stamp among them.

    The IMU is not interpolated across gaps longer than `max_gap`, seconds, and a field sample
    further from the newest IMU sample has no up vector. `is_repeated` is whether the newest field
    sample has the same values as the previous one, and `turned_unchanged` the largest angle by
    which the robot has turned since these values first came, radians. `lead_at_imu` and
    `lead_at_field` are the newest field stamp minus the newest IMU stamp, when the newest sample of
    each came, seconds; infinite while one is missing. `largest_field` is the size of the last field
    that was too large, tesla as published; zero if none was.
    """

    def __init__(self, max_gap: float) -> None:
        self.max_gap = max_gap
        self.imu_drops: Counter[DropReason] = Counter()
        self.field_drops: Counter[DropReason] = Counter()
        self.imu_stamps = StampGuard()
        self.field_stamps = StampGuard()
        self._imu: deque[ImuSample] = deque(maxlen=STREAMS.remembered)
        self._last_rate = -math.inf
        self._last_field = (math.nan, math.nan, math.nan)
        self.is_repeated = False
        self._turned = self.turned_unchanged = 0.0
        self.largest_field = 0.0
        self.lead_at_imu = -math.inf
        self.lead_at_field = math.inf

    def add_imu(self, sample: ImuSample) -> bool:
        """Take an IMU sample; returns whether it was usable.

        A sample without a rate is valid if there is no gyro. Shortly after a rate it is a fault,
        and the gyro is integrated across it.
        """
        p, q, r = sample.rate
        went_back_from = self.imu_stamps.newest
        reason = _fault(sample.force, STREAMS.largest_force)
        # Without a gyro the rate is NaN, and the comparison is false.
        if reason is None and p * p + q * q + r * r > STREAMS.largest_rate**2:
            reason = DropReason.TOO_LARGE
        has_rate = math.isfinite(p + q + r)
        # A rate shortly before means that there is a gyro.
        has_gyro = abs(sample.stamp - self._last_rate) < STREAMS.longest_gyro_step
        if reason is None and not has_rate and has_gyro:
            reason = DropReason.NOT_FINITE
        reason = reason or self.imu_stamps.check(sample.stamp)
        if reason is not None:
            self.imu_drops[reason] += 1
            return False
        if sample.stamp < went_back_from:
            self._imu.clear()
        if has_rate:
            self._last_rate = sample.stamp
        self._imu.append(sample)
        self.lead_at_imu = self.field_stamps.newest - sample.stamp
        return True

    def add_field(self, sample: FieldSample, turned: float = 0.0) -> bool:
        """Take a field sample; returns whether a corrected field may be made of it.

        A sample with the values of the previous one is counted as repeated, but usable: at rest,
        quantised values may repeat. `turned` is the turn by the gyro so far, radians.
        """
        reason = _fault(sample.field, STREAMS.largest_field)
        if reason is DropReason.TOO_LARGE:
            self.largest_field = length(sample.field)
        reason = reason or self.field_stamps.check(sample.stamp)
        if reason is not None:
            self.field_drops[reason] += 1
            return False
        self.lead_at_field = sample.stamp - self.imu_stamps.newest
        self.is_repeated = sample.field == self._last_field
        if self.is_repeated:
            self.field_drops[DropReason.REPEATED] += 1
            self.turned_unchanged = max(self.turned_unchanged, abs(turned - self._turned))
        else:
            self._turned, self.turned_unchanged = turned, 0.0
        self._last_field = sample.field
        return True

    def imu_at(self, stamp: float) -> ImuSample | None:
        """Return the IMU interpolated at a stamp; None unless two near samples enclose it."""
        found = enclosing(self._imu, stamp)
        if found is None:
            return None
        before, after = found
        if before.stamp == stamp:
            return before
        if after is None or after.stamp - before.stamp > self.max_gap:
            return None
        share = (stamp - before.stamp) / (after.stamp - before.stamp)
        force = interpolate(before.force, after.force, share)
        return ImuSample(stamp, force, interpolate(before.rate, after.rate, share))

    def imu_between(self, start: ImuSample, end: ImuSample) -> ImuSpan | None:
        """Integrate the IMU between two samples; None if samples or rates are missing there.

        By the trapezoidal rule; rotations are multiplied, and may be large.
        """
        samples = [end]
        for sample in reversed(self._imu):
            if sample.stamp <= start.stamp:
                break
            if sample.stamp < end.stamp and sample.is_measured:
                samples.append(sample)
        samples.append(start)
        ax = ay = az = x = y = z = vx = vy = vz = 0.0
        w = 1.0
        for later, earlier in zip(samples[-2::-1], samples[:0:-1], strict=True):
            half = 0.5 * (later.stamp - earlier.stamp)
            if not 0.0 < 2.0 * half <= self.max_gap:
                return None
            (px, py, pz), (qx, qy, qz) = earlier.rate, later.rate
            dx, dy, dz = half * (px + qx), half * (py + qy), half * (pz + qz)
            ax, ay, az = ax + dx, ay + dy, az + dz
            # Cosine and sine of half the step, the latter over the step.
            square = 0.25 * (dx * dx + dy * dy + dz * dz)
            c, s = 1.0 - square * (0.5 - square / 24.0), 0.5 - square / 12.0
            w, x, y, z = (
                c * w - s * (x * dx + y * dy + z * dz),
                c * x + s * (w * dx + y * dz - z * dy),
                c * y + s * (w * dy + z * dx - x * dz),
                c * z + s * (w * dz + x * dy - y * dx),
            )
            (px, py, pz), (qx, qy, qz) = earlier.force, later.force
            vx, vy, vz = vx + half * (px + qx), vy + half * (py + qy), vz + half * (pz + qz)
        if not math.isfinite(ax + ay + az):
            return None
        angle = _vector_of(w, (x, y, z), (ax, ay, az))
        return ImuSpan(angle, (vx, vy, vz), len(samples) - 1)

    @property
    def newest_imu(self) -> ImuSample | None:
        """The newest IMU sample; None before the first."""
        return self._imu[-1] if self._imu else None


def enclosing(samples: Sequence[Stamped], stamp: float) -> tuple[Stamped, Stamped | None] | None:
    """Return the newest sample at or before a stamp, and the one after it.

    Samples begin with their stamps, which increase. None where all are later.
    """
    after = None
    for sample in reversed(samples):
        if sample[0] <= stamp:  # type: ignore[operator]
            return sample, after
        after = sample
    return None


def _fault(vector: Triple, largest: float) -> DropReason | None:
    """Return why a vector cannot have been measured; None if it can."""
    x, y, z = vector
    square = x * x + y * y + z * z
    if not math.isfinite(square):
        return DropReason.NOT_FINITE
    if square < STREAMS.smallest**2:
        return DropReason.ZERO
    return DropReason.TOO_LARGE if square > largest * largest else None


def _vector_of(w: float, part: Triple, near: Triple) -> Triple:
    """Return the rotation vector, radians, of a quaternion: the one nearest to another vector."""
    sine = length(part)
    if sine < 1e-12:
        return near
    angle = 2.0 * math.atan2(sine, w)
    angle += math.tau * round((dot(near, part) / sine - angle) / math.tau)
    return scaled(part, angle / sine)


class Pairer:
    """Holds field samples until the IMU samples around them have come.

    With `counts`, field samples without IMU samples are added to the drops of the streams.
    """

    def __init__(self, streams: Streams, *, counts: bool = True) -> None:
        self._streams, self._counts = streams, counts
        self._waiting: deque[FieldSample] = deque()
        self._last: ImuSample | None = None

    def offer(self, sample: FieldSample) -> None:
        """Add a field sample, which must not repeat the previous one.

        If its stamp is before those that wait, time was set back: their IMU samples never come.
        """
        while self._waiting and self._waiting[-1].stamp > sample.stamp:
            self._waiting.pop()
            self._count_unpaired()
        if len(self._waiting) == STREAMS.remembered:
            self._waiting.popleft()
            self._count_unpaired()
        self._waiting.append(sample)

    def take(self) -> list[Pair]:
        """Return the pairs that can be made now, in the order of their stamps."""
        pairs: list[Pair] = []
        newest = self._streams.newest_imu
        while self._waiting and newest and newest.stamp >= self._waiting[0].stamp:
            sample = self._waiting.popleft()
            imu = self._streams.imu_at(sample.stamp)
            if imu is None:
                self._count_unpaired()
            else:
                last, self._last = self._last, imu
                span = None if last is None else self._streams.imu_between(last, imu)
                pairs.append(Pair(sample, imu, span))
        return pairs

    def _count_unpaired(self) -> None:
        if self._counts:
            self._streams.field_drops[DropReason.UNPAIRED] += 1


class SpeedSample(NamedTuple):
    """Speed along the vehicle's x (m/s, negative backwards) at a stamp (s).

    `is_signed` is false if the source gives no direction, such as a receiver's speed over ground.
    """

    stamp: float
    speed: float
    is_signed: bool = True


class PositionSample(NamedTuple):
    """Place in a local plane, metres east and north of any origin, at a stamp (s)."""

    stamp: float
    east: float
    north: float


class VelocitySample(NamedTuple):
    """Velocity over ground, m/s east and north, at a stamp (s), and its sigma per axis, m/s."""

    stamp: float
    east: float
    north: float
    sigma: float


TravelSample = SpeedSample | PositionSample | VelocitySample  # whatever shows how a vehicle travels


class HeadingSample(NamedTuple):
    """ENU yaw (rad) of another device, with its sigma, at a stamp (s)."""

    stamp: float
    yaw: float
    sigma: float
