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
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from magcal_ros.core.driving.driving_tuning import ACCELERATION, MOUNTING, SPEED, SpeedSource
from magcal_ros.core.driving.gyro_frame import Tick
from magcal_ros.core.driving.speed import Speedometer, SpeedTrack
from magcal_ros.core.geometry.arrays import ComplexArray, FloatArray
from magcal_ros.core.up.filter import FILTER

UNITS = {3.6: "km/h", 2.237: "mph", 1.944: "knots", 100.0: "cm/s", 1000.0: "mm/s"}
"""Units of speed by their number in one m/s."""
HIGHPASS = int(ACCELERATION.memory / ACCELERATION.seconds)
"""Ticks of the running mean that is subtracted."""


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
    scale: float  # force over change of velocity: one for a speed in m/s without latency or noise
    delay: float  # latency of the speed's stamps, seconds
    explained: float  # fraction of the force's changes that the speed explains
    energy: float  # integrated square of the changes of the force, m²/s³
    noise: float  # residual of the force, m/s²
    density: float
    """Spectral density of the residual in body axes at the frequency zero, per axis, m²/s³."""
    is_constant: bool = False  # whether the speed has not changed lately
    jumps: bool = False  # whether the speed often changes by more than a vehicle's can

    @property
    def fault(self) -> SpeedFault | None:
        """What is wrong with the speed; None as well before enough starts and stops."""
        if self.jumps:
            return SpeedFault.JUMPS
        if self.energy < MOUNTING.energy:
            return None
        # Noise of the speed reduces the scale, at most to the fraction that is explained.
        most = self.scale / max(self.explained, MOUNTING.explained)
        fault = None
        if self.explained < MOUNTING.explained:
            fault = SpeedFault.UNRELATED
        elif not self.scale - MOUNTING.scale <= 1.0 <= most + MOUNTING.scale:
            fault = SpeedFault.SCALE
        elif self.delay > ACCELERATION.oldest:
            fault = SpeedFault.LATE
        return SpeedFault.FROZEN if fault and self.is_constant else fault

    @property
    def is_known(self) -> bool:
        """Whether the speed shows the yaw."""
        return self.sigma < MOUNTING.usable and self.fault is None


class Changes(NamedTuple):
    """Changes of force and velocity, low-passed minus their running mean, m/s²."""

    stamp: FloatArray  # shape (n,), seconds
    seconds: FloatArray  # length of each tick, shape (n,)
    ahead: ComplexArray  # unit vector along the body's x in the frame, shape (n,)
    force: ComplexArray  # shape (n,)
    columns: ComplexArray  # change of velocity, and of the velocity of a lever arm, shape (2, n)


class TickTable(NamedTuple):
    """Ticks of a drive in arrays of shape (n,)."""

    stamp: FloatArray
    seconds: FloatArray
    """End and length of each tick."""
    force: ComplexArray  # m/s² across up in the gyro's frame
    yaw: FloatArray
    turn_rate: FloatArray
    """Of the IMU in the frame, radians and rad/s."""

    @classmethod
    def of(cls, ticks: Sequence[Tick]) -> TickTable:
        """Return ticks in arrays."""
        rows = [(t.stamp, t.seconds, t.level_force, t.yaw, t.turn_rate) for t in ticks]
        stamp, seconds, force, yaw, rate = np.array(rows, dtype=np.complex128).reshape(-1, 5).T
        return cls(stamp.real, seconds.real, force, yaw.real, rate.real)

    def changes(self, speed: FloatArray) -> Changes:
        """Return the changes at the ticks before which the speed (n,) at their ends is known."""
        ahead = np.exp(1j * self.yaw)
        ends = 0.5 * (self.turn_rate + np.append(self.turn_rate[1:], self.turn_rate[-1]))
        moved = np.diff([speed * ahead, 1j * ends * ahead], prepend=np.nan) / self.seconds
        gap = np.diff(self.stamp, prepend=-np.inf)
        known = np.isfinite(moved[0]) & (np.abs(gap - self.seconds) < 0.5 * self.seconds)
        sums = np.cumsum(np.where(known, [self.force, *moved, known], 0.0), axis=1)
        sums, row = np.pad(sums, ((0, 0), (1, 0))), np.flatnonzero(known)

        def mean(width: int) -> ComplexArray:
            last = np.minimum(np.maximum(row - width // 2, 0) + width, len(known))
            total = sums[:, last] - sums[:, np.maximum(last - width, 0)]
            return np.asarray(total[:3] / total[3].real)

        rows = mean(MOUNTING.smooth) - mean(HIGHPASS)
        return Changes(self.stamp[known], self.seconds[known], ahead[known], rows[0], rows[1:])

    def signed(self, speed: FloatArray, turn: complex) -> FloatArray:
        """Return a speed with the sign of the force in each trip.

        `turn` is the direction of the force for a change of velocity ahead.
        """
        moving = np.abs(np.nan_to_num(speed)) > ACCELERATION.speed_at_rest
        trip = np.where(moving, np.cumsum(moving & ~np.append(False, moving[:-1])), 0)
        found = self.changes(speed)
        product = (found.force * np.conj(found.columns[0] * turn)).real
        shown = np.bincount(trip[np.isin(self.stamp, found.stamp)], product, trip.max() + 1)
        return np.asarray(np.where(moving & (shown < 0.0)[trip], -speed, speed))


def fit_mounting_yaw(changes: Changes, delay: float) -> MountingYaw | None:
    """Fit yaw, scale and lever arm; None without enough ticks.

    The speeds are already corrected by the latency `delay`, seconds. Least squares with Student
    weights. Errors within a block of time count as fully correlated.
    """
    stamp, seconds, ahead, force, columns = changes
    if len(force) < HIGHPASS // 4:
        return None
    squares = np.abs(force) ** 2
    error, weight = force, np.ones(len(force))
    for _ in range(MOUNTING.rounds):
        noise = max(1e-3, 1.26 * float(np.median(np.abs(error))))
        # Smoothed rows are correlated: the prior is scaled by the number of correlated rows.
        prior = noise**2 * MOUNTING.smooth / MOUNTING.lever_sigma**2
        weighted = columns.conj() * weight
        inverse = np.linalg.inv(weighted @ columns.T + np.diag([1e-9, prior]))
        found = inverse @ weighted @ force
        error = force - found @ columns
        weight = 1.0 / (1.0 + np.abs(error) ** 2 / (4.0 * noise**2))
    blocks = np.flatnonzero(np.diff(stamp // (0.5 * ACCELERATION.memory), prepend=-1.0))
    steps = inverse[0] @ np.add.reduceat(weighted * error, blocks, axis=1)
    by_lever = inverse[0, 1] * prior * MOUNTING.lever_sigma
    z = complex(found[0]) or 1e-9 + 0j
    # The part of a step across z changes the angle of z. A few blocks may agree by chance.
    variance = float(np.sum((steps / z).imag ** 2)) + abs(by_lever / z) ** 2
    variance += noise**2 * float(inverse[0, 0].real) / abs(z) ** 2
    # A wrong speed explains nothing, but does not count as worse than no speed.
    left = float(np.sum(np.minimum(np.abs(error) ** 2, squares)))
    sums = np.add.reduceat(error / ahead * seconds, blocks)
    known = MOUNTING.density_known_for
    density = known * 2.0 * noise**2 * FILTER.acceleration_lasts
    density += 0.5 * float(np.sum(np.abs(sums) ** 2))
    density /= known + float(np.sum(seconds))
    return MountingYaw(
        -cmath.phase(z),
        min(math.pi, math.sqrt(variance + MOUNTING.floor**2)),
        abs(z),
        delay,
        1.0 - left / max(float(np.sum(squares)), 1e-300),
        float(squares @ seconds),
        noise,
        density,
    )


def latency(ticks: TickTable, track: SpeedTrack) -> float:
    """Return the latency with the largest correlation of force and change of velocity, seconds."""
    step = 2.0 * ACCELERATION.seconds
    delays = np.arange(-MOUNTING.largest_delay / 8.0, MOUNTING.largest_delay + step, step)
    scores = np.zeros(len(delays))
    for row, speed in enumerate(track.along(ticks.stamp, delays[:, None])):
        found = ticks.changes(speed)
        size = float(np.linalg.norm(found.force) * np.linalg.norm(found.columns[0]))
        scores[row] = abs(np.vdot(found.columns[0], found.force)) / max(size, 1e-9)
    best = int(np.argmax(scores))
    is_better = scores[best] > np.interp(track.delay, delays, scores) + 0.02
    if scores[best] ** 2 < MOUNTING.explained or not is_better or best in (0, len(delays) - 1):
        return track.delay
    before, top, after = scores[best - 1 : best + 2]
    return float(delays[best] + 0.5 * step * (after - before) / (2.0 * top - before - after))


def check_speed(
    ticks: TickTable, track: SpeedTrack, delay: float, turn: complex | None
) -> MountingYaw | None:
    """Fit the yaw by one source; if its speed has a fault, the fit shows it."""
    speed = track.along(ticks.stamp, delay)
    if turn is not None and not track.is_signed:
        speed = ticks.signed(speed, turn)
    changes = ticks.changes(speed)
    found = fit_mounting_yaw(changes, delay)
    if found is None:
        return None
    # The newest starts and stops show a new fault of wheels. A receiver is temporarily worse
    # between houses.
    energy = np.cumsum((np.abs(changes.force) ** 2 * changes.seconds)[::-1])
    count = int(np.searchsorted(energy, MOUNTING.energy)) + 1
    if track.source is SpeedSource.ODOMETRY:
        newest_changes = Changes(*(each[..., -count:] for each in changes))  # type: ignore[arg-type]
        newest = fit_mounting_yaw(newest_changes, delay)
        found = newest if newest is not None and newest.fault is not None else found
    newest_speeds = speed[-count // 2 :]
    is_constant = len(np.unique(newest_speeds[np.isfinite(newest_speeds)])) == 1
    jumps = track.outlier_share > SPEED.outliers
    return replace(found, is_constant=is_constant, jumps=jumps)


class MountingYawEstimator:
    """Keeps the ticks of some minutes, and fits them periodically.

    `found` is the newest fit of the source in use, and `checked` that of each source.
    """

    def __init__(self, speedometer: Speedometer) -> None:
        self._speedometer = speedometer
        self._ticks: deque[Tick] = deque(maxlen=int(ACCELERATION.remembered / ACCELERATION.seconds))
        self._fitted_at = -math.inf
        self._fits = 0
        self.found: MountingYaw | None = None
        self.checked: dict[SpeedSource, MountingYaw] = {}

    @property
    def faults(self) -> dict[SpeedSource, SpeedFault]:
        """The faults by source."""
        return {source: fit.fault for source, fit in self.checked.items() if fit.fault is not None}

    def add(self, tick: Tick, speed: float) -> bool:
        """Add a tick and its speed (m/s, NaN if unknown); return whether a fit is due."""
        # A vehicle at rest provides no information.
        is_at_rest = abs(speed) <= ACCELERATION.speed_at_rest
        if not is_at_rest or math.hypot(*tick.force[:2]) > ACCELERATION.quiet:
            self._ticks.append(tick)
        return tick.stamp - self._fitted_at >= MOUNTING.reuse

    def restart(self) -> None:
        """Forget the ticks: time was set back."""
        self._ticks.clear()
        self._fitted_at = -math.inf

    def begin_fit(
        self, stamp: float, turn: complex | None
    ) -> Callable[[], dict[SpeedSource, MountingYaw]]:
        """Return a function that fits the drive, for any thread; `take` uses its result.

        `turn` is the direction of the force for a change of velocity ahead, if it is known. Every
        eighth fit tests all sources and measures their latencies; the others end at the first good
        source.
        """
        self._fitted_at = stamp
        self._fits += 1
        ticks, is_thorough = list(self._ticks), self._fits % 8 == 0
        recent = [
            track.copy()
            for track in self._speedometer.tracks.values()
            if stamp - track.newest <= 2.0 * MOUNTING.reuse
        ]

        def work() -> dict[SpeedSource, MountingYaw]:
            checks: dict[SpeedSource, MountingYaw] = {}
            if len(ticks) < HIGHPASS // 2:
                return checks
            table = TickTable.of(ticks)
            for track in recent:
                delay = latency(table, track) if is_thorough else track.delay
                found = check_speed(table, track, delay, turn)
                if found is not None:
                    checks[track.source] = found
                    if found.fault is None and not is_thorough:
                        break
            return checks

        return work

    def take(self, checks: dict[SpeedSource, MountingYaw]) -> None:
        """Use the results of a fit: the best source without a fault is used."""
        self.found = next((found for found in checks.values() if found.fault is None), None)
        for source, found in checks.items():
            # A fault lasts until a fit shows that it does not. A speed that stays the same shows
            # nothing while the vehicle stands or keeps its velocity.
            is_right = found.is_known and not found.is_constant
            if source not in self.faults or found.fault is not None or is_right:
                self.checked[source] = found
            self._speedometer.tracks[source].delay = found.delay
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
