"""The yaw of the IMU in the vehicle: specific force against the change of velocity.

In a level frame that the gyro stabilises (`GyroFrame`), with the IMU's yaw theta in it,

    F = z d/dt [v e^(i theta)] + w d/dt [i r e^(i theta)] + e,    z = s e^(-i beta).

F is the force across up, v the signed speed, r the turn rate, and w the lever arm from the rear
axle to the IMU. beta is the yaw of the IMU in the vehicle, and s is one if the speed's unit is
right.
Neither field nor course is needed. All terms are low-passed over a second, minus their mean over
20 s.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from magcal_ros.core.driving.chords import Tick
from magcal_ros.core.driving.driving_tuning import ACCELERATION, MOUNTING, SpeedSource
from magcal_ros.core.driving.speed import Speedometer, SpeedTrack
from magcal_ros.core.geometry.arrays import BoolArray, ComplexArray, FloatArray, IntArray

UNITS = {3.6: "km/h", 2.237: "mph", 1.944: "knots", 100.0: "cm/s", 1000.0: "mm/s"}
"""Units of speed by their number in one m/s."""


class SpeedFault(str, Enum):
    """What is wrong with a speed."""

    JUMPS = "jumps"
    FROZEN = "frozen"
    SCALE = "scale"
    LATE = "late"
    UNRELATED = "unrelated"


@dataclass(frozen=True)
class MountingYaw:
    """The yaw of the IMU in the vehicle, and how well the speed explains its force."""

    yaw: float
    sigma: float
    """Radians, counter-clockwise from the vehicle's x to the IMU's x."""
    scale: float  # force over change of velocity: one for a speed in m/s without latency
    delay: float  # latency of the speed's stamps, seconds
    explained: float  # fraction of the force's changes that the speed explains
    energy: float  # integrated square of the changes of velocity, m²/s³
    force_energy: float  # the same for the force
    noise: float  # residual of the force, m/s²
    is_rough: bool = False
    """Whether the speed is a receiver's, whose noise reduces the scale."""

    def _explains(self, energy: float) -> bool:
        is_enough = min(self.energy, self.force_energy) >= energy
        return is_enough and self.explained >= MOUNTING.explained

    @property
    def is_usable(self) -> bool:
        """Whether the yaw is good enough to subtract the vehicle's acceleration."""
        return self._explains(MOUNTING.first_energy) and self.sigma < MOUNTING.usable

    @property
    def has_scale(self) -> bool:
        """Whether the speed is in m/s."""
        below = MOUNTING.rough_scale if self.is_rough else MOUNTING.scale
        return -below <= self.scale - 1.0 <= MOUNTING.scale

    @property
    def is_known(self) -> bool:
        """Whether the speed explains enough changes of velocity."""
        return self._explains(MOUNTING.energy) and self.has_scale


class TickTable(NamedTuple):
    """Ticks of a drive in arrays of shape (n,), with the speed at the end of each."""

    stamp: FloatArray
    seconds: FloatArray
    """End and length of each tick."""
    force: ComplexArray  # m/s² across up in the gyro's frame
    yaw: FloatArray
    turn_rate: FloatArray
    """Of the IMU in the frame, radians and rad/s."""
    speed: FloatArray  # m/s; NaN if unknown
    is_signed: bool  # whether backwards is negative

    def last(self, count: int) -> TickTable:
        """Return the newest ticks."""
        return self._replace(**{n: getattr(self, n)[-count:] for n in self._fields[:-1]})


class SpeedCheck(NamedTuple):
    """The result of a fit for one source of speed: yaw, fault and latency."""

    source: SpeedSource
    fitted: MountingYaw | None
    fault: SpeedFault | None
    delay: float


def _judge(
    source: SpeedSource, table: TickTable, record: SpeedTrack, measures_delay: bool
) -> SpeedCheck:
    delay = _delay(table, record) if measures_delay else record.delay
    met = _at_delay(table, record, delay)
    is_rough = source is not SpeedSource.ODOMETRY
    newest = met.last(MOUNTING.stuck)
    if len(newest.speed) == MOUNTING.stuck and np.ptp(newest.speed) == 0.0:
        stuck = fit_mounting_yaw(newest, delay, is_rough)
        is_moved = stuck is not None and stuck.force_energy > MOUNTING.first_energy
        if stuck is not None and is_moved and stuck.explained < MOUNTING.explained:
            return SpeedCheck(source, stuck, SpeedFault.FROZEN, delay)
    # Wheels are also tested over the last minute, in which a new fault is clear. A receiver is
    # temporarily worse between houses.
    for ticks in (met,) if is_rough else (met.last(MOUNTING.recent), met):
        found = fit_mounting_yaw(ticks, delay, is_rough)
        fault = None if found is None else _fault(record, found)
        if fault is not None:
            break
    return SpeedCheck(source, found, fault, delay)


def _at_delay(table: TickTable, record: SpeedTrack, delay: float) -> TickTable:
    """Return ticks with the speeds of a source at a latency."""
    return table._replace(speed=record.along(table.stamp, delay), is_signed=record.is_signed)


def _fault(record: SpeedTrack, fitted: MountingYaw) -> SpeedFault | None:
    if record.outlier_share > MOUNTING.outliers:
        return SpeedFault.JUMPS
    if fitted.force_energy < MOUNTING.energy:
        return None
    if fitted.energy < 0.02 * fitted.force_energy:
        return SpeedFault.FROZEN
    if fitted.explained < MOUNTING.explained:
        return SpeedFault.UNRELATED
    if not fitted.has_scale:
        return SpeedFault.SCALE
    return SpeedFault.LATE if fitted.delay > ACCELERATION.oldest else None


def _delay(table: TickTable, record: SpeedTrack) -> float:
    """Return the latency with the largest correlation of force and change of velocity."""
    step = 2.0 * ACCELERATION.seconds
    if len(table.stamp) < 2 * MOUNTING.highpass:
        return record.delay
    delays = np.arange(-MOUNTING.largest_delay / 8.0, MOUNTING.largest_delay + step, step)
    speeds = record.along(table.stamp, delays[:, None])
    scores = np.array([_correlation(table._replace(speed=speed)) for speed in speeds])
    best = int(np.argmax(scores))
    now = float(np.interp(record.delay, delays, scores))
    is_clear = scores[best] ** 2 > MOUNTING.explained and scores[best] > now + 0.02
    if not is_clear or best in (0, len(delays) - 1):
        return record.delay
    before, top, after = scores[best - 1 : best + 2]
    bend = before - 2.0 * top + after
    shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float(delays[best] + step * shift)


def _correlation(ticks: TickTable) -> float:
    """Return the correlation of force and change of velocity, zero to one."""
    force, change, _, _ = _filtered(ticks)
    size = float(np.linalg.norm(force) * np.linalg.norm(change))
    return 0.0 if size <= 0.0 else float(abs(np.vdot(change, force))) / size


def _filtered(ticks: TickTable) -> tuple[ComplexArray, ComplexArray, ComplexArray, BoolArray]:
    """Return force, change of velocity, that of a lever arm's, filtered, and which are valid."""
    ahead = np.exp(1j * ticks.yaw)
    ends = 0.5 * (ticks.turn_rate + np.append(ticks.turn_rate[1:], ticks.turn_rate[-1]))
    change, swing = (
        np.diff(each, prepend=np.nan) / ticks.seconds
        for each in (ticks.speed * ahead, 1j * ends * ahead)
    )
    gap = np.diff(ticks.stamp, prepend=-np.inf)
    valid = np.isfinite(change) & (np.abs(gap - ticks.seconds) < 0.5 * ticks.seconds)
    counts = np.append(0, np.cumsum(valid))

    def banded(values: FloatArray | ComplexArray) -> ComplexArray:
        sums = np.append(0.0, np.cumsum(np.where(valid, values, 0.0)))
        low, mean = (_running(sums, counts, w) for w in (MOUNTING.smooth, MOUNTING.highpass))
        return np.where(valid, low - mean, 0.0)

    return banded(ticks.force), banded(change), banded(swing), valid


def _running(sums: ComplexArray, counts: IntArray, width: int) -> ComplexArray:
    """Return the running mean over `width` rows, from cumulative sums and counts of valid rows."""
    total = len(sums) - 1
    last = np.minimum(np.maximum(np.arange(total) - width // 2, 0) + width, total)
    first = np.maximum(last - width, 0)
    return np.asarray((sums[last] - sums[first]) / np.maximum(counts[last] - counts[first], 1))


def _signs(ticks: TickTable, force: ComplexArray, change: ComplexArray) -> FloatArray:
    """Return the sign of the speed in each row; most of the path counts as forwards."""
    speed = np.abs(np.nan_to_num(ticks.speed))
    moving = speed > ACCELERATION.speed_at_rest
    label = np.where(moving, np.cumsum(moving & ~np.append(False, moving[:-1])), 0)
    count = int(label.max()) + 1
    product = force * np.conj(change)
    sums = np.bincount(label, product.real, count) + 1j * np.bincount(label, product.imag, count)
    sums[0] = 0.0
    # The squares of the trips' sums are independent of the trips' signs.
    axis = cmath.exp(0.5j * cmath.phase(complex(np.sum(sums**2))))
    sign = np.where((sums * np.conj(axis)).real < 0.0, -1.0, 1.0)
    if float(sign @ np.bincount(label, speed * ticks.seconds, count)) < 0.0:
        sign = -sign
    sign[0] = 1.0
    return np.asarray(sign[label])


def fit_mounting_yaw(ticks: TickTable, delay: float, is_rough: bool) -> MountingYaw | None:
    """Fit yaw, scale and lever arm; None without enough ticks.

    The speeds are already corrected by the latency `delay`, seconds. Least squares with weights
    1/(1 + |e|²/4s²); errors within a block of time count as fully correlated.
    """
    if len(ticks.stamp) < MOUNTING.highpass // 2 or not np.isfinite(ticks.speed).any():
        return None
    force, change, swing, valid = _filtered(ticks)
    if valid.sum() < MOUNTING.highpass // 4:
        return None
    if not ticks.is_signed:
        signed = ticks.speed * _signs(ticks, force, change)
        force, change, swing, valid = _filtered(ticks._replace(speed=signed))
    force, columns = force[valid], np.array([change[valid], swing[valid]])
    period = float(np.median(ticks.seconds))
    squares = np.abs(force) ** 2
    force_energy = float(np.sum(squares)) * period
    energy = float(np.sum(np.abs(columns[0]) ** 2)) * period
    if energy <= 0.0:
        return MountingYaw(0.0, math.pi, 0.0, delay, 0.0, 0.0, force_energy, math.inf, is_rough)
    error, weight = force, np.ones(len(force))
    for _ in range(MOUNTING.rounds):
        # The median of a Rayleigh distribution is 1.177 of its components' sigma.
        noise = max(1e-3, 1.26 * float(np.median(np.abs(error))))
        # Smoothed rows are correlated: the prior is scaled by the number of correlated rows.
        prior = noise**2 * MOUNTING.smooth / MOUNTING.lever_sigma**2
        weighted = columns.conj() * weight
        inverse = np.linalg.inv(weighted @ columns.T + np.diag([1e-9, prior]))
        found = inverse @ weighted @ force
        error = force - found @ columns
        weight = 1.0 / (1.0 + np.abs(error) ** 2 / (4.0 * noise**2))
    stamp = ticks.stamp[valid]
    blocks = np.flatnonzero(np.diff(np.floor((stamp - stamp[0]) / MOUNTING.block), prepend=-1.0))
    steps = inverse[0] @ np.add.reduceat(weighted * error, blocks, axis=1)
    by_lever = inverse[0, 1] * prior * MOUNTING.lever_sigma
    z = complex(found[0])
    # The part of a step across z changes the angle of z.
    variance = float(np.sum((steps / z).imag ** 2)) + abs(by_lever / z) ** 2
    # A wrong speed explains nothing, but does not count as worse than no speed.
    left = float(np.sum(np.minimum(np.abs(error) ** 2, squares)))
    return MountingYaw(
        -cmath.phase(z),
        min(math.pi, math.sqrt(variance + MOUNTING.floor**2)),
        abs(z),
        delay,
        1.0 - left / max(float(np.sum(squares)), 1e-300),
        energy,
        force_energy,
        noise,
        is_rough,
    )


class MountingYawEstimator:
    """Keeps the ticks of some minutes, and fits them periodically.

    `found` is the newest fit of the source in use, `checked` that of each source, and `faults` are
    the faults by source.
    """

    def __init__(self, speedometer: Speedometer) -> None:
        self._speedometer = speedometer
        self._ticks: deque[Tick] = deque(maxlen=MOUNTING.remembered)
        self._fitted_at = -math.inf
        self._fits = 0
        self.found: MountingYaw | None = None
        self.faults: dict[SpeedSource, SpeedFault] = {}
        self.checked: dict[SpeedSource, MountingYaw] = {}

    def add(self, tick: Tick, speed: float) -> bool:
        """Add a tick and its speed (m/s, NaN if unknown); return whether a fit is due."""
        # A vehicle at rest provides no information.
        if abs(speed) > ACCELERATION.speed_at_rest or abs(tick.level_force) > ACCELERATION.quiet:
            self._ticks.append(tick)
        return tick.stamp - self._fitted_at >= MOUNTING.reuse

    def restart(self) -> None:
        """Forget the ticks: time was set back."""
        self._ticks.clear()
        self._fitted_at = -math.inf

    def begin_fit(self, stamp: float) -> Callable[[], tuple[SpeedCheck, ...]]:
        """Return a function that fits the drive, for any thread; `take` uses its result.

        Every eighth fit tests all sources and measures their latencies; the others end at the first
        good source.
        """
        self._fitted_at = stamp
        self._fits += 1
        ticks, is_thorough = list(self._ticks), self._fits % 8 == 0
        recent = [
            (source, track.copy())
            for source, track in self._speedometer.tracks.items()
            if stamp - track.newest <= 2.0 * MOUNTING.reuse
        ]

        def work() -> tuple[SpeedCheck, ...]:
            rows = [(t.stamp, t.seconds, t.yaw, t.turn_rate, math.nan) for t in ticks]
            stamps, seconds, yaw, rate, speed = np.array(rows, dtype=float).reshape(-1, 5).T
            force = np.array([tick.level_force for tick in ticks], dtype=np.complex128)
            table = TickTable(stamps, seconds, force, yaw, rate, speed, True)
            judged: list[SpeedCheck] = []
            for source, record in recent:
                judged.append(_judge(source, table, record, is_thorough))
                is_good = judged[-1].fitted is not None and judged[-1].fault is None
                if is_good and not is_thorough:
                    break
            return tuple(judged)

        return work

    def take(self, judged: tuple[SpeedCheck, ...]) -> None:
        """Use the results of a fit: the best source without a fault is used."""
        self.found = None
        for source, fitted, fault, delay in judged:
            if fitted is not None:
                self.checked[source] = fitted
            self._speedometer.tracks[source].delay = delay
            if fault is None:
                self.faults.pop(source, None)
                self.found = self.found or fitted
            else:
                self.faults[source] = fault
        self._speedometer.distrusted = set(self.faults)


def fault_words(topic: str, fault: SpeedFault, fitted: MountingYaw) -> str:
    """Return the fault of a speed in words, with a remedy."""
    if fault is SpeedFault.SCALE:
        times = 1.0 / max(fitted.scale, 1e-6)
        unit = next((name for k, name in UNITS.items() if abs(times / k - 1.0) < 0.12), "")
        guess = f", as if it were in {unit}" if unit else ""
        what = f"is {times:.2g} times the speed by the accelerometer{guess}: publish m/s"
    else:
        what = {
            SpeedFault.JUMPS: "jumps more than a vehicle can: check the encoder and its driver",
            SpeedFault.FROZEN: "does not change during movement: check its driver",
            SpeedFault.LATE: f"is late by {fitted.delay:.1f} s: stamp it when it is measured",
            SpeedFault.UNRELATED: (
                "does not match the accelerometer: check that it is this vehicle's, and stamped "
                "by the same clock"
            ),
        }[fault]
    return f"{topic}: its speed {what}. It is not used"
