"""The yaw of the IMU in the vehicle: specific force against the change of velocity.

In a level frame that the gyro keeps still (`gyro_frame`), with the IMU's yaw theta in it,

    F = z d/dt [(v + i l w) e^(i theta)] + e,    z = s e^(-i beta),

where F is the force across up, v the signed speed, w the turn rate, l the way from the rear axle
to the IMU, beta the yaw of the IMU in the vehicle and s one if the speed's unit is right. Neither
field nor course is needed. All are low-passed over a second and less their mean over 20 s.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from magcal_ros.core.driving.driving_tuning import MOUNTING, TRIP
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray

ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class MountingYaw:
    """How the IMU sits in the vehicle, and how well the speed fits its force."""

    yaw: float
    sigma: float
    """Radians, counter-clockwise from the vehicle's x to the IMU's x."""
    scale: float  # force over change of velocity: one, if the speed is in m/s and in time
    delay: float  # seconds by which the speed's stamps are late
    explained: float  # share of the force's changes that the speed explains
    energy: float  # m²/s³ of changes of velocity that were seen
    force_energy: float  # the same of the force
    seconds: float  # of driving that were fitted
    noise: float  # m/s² that the force departs by
    is_rough: bool = False
    """Whether the speed is a receiver's, whose noise makes the scale less than one."""

    @property
    def is_usable(self) -> bool:
        """Whether it is good enough to take the vehicle's own acceleration off."""
        is_enough = min(self.energy, self.force_energy) >= MOUNTING.first_energy
        return is_enough and self.explained >= MOUNTING.explained and self.sigma < MOUNTING.believed

    @property
    def has_scale(self) -> bool:
        """Whether the speed is in m/s."""
        below = MOUNTING.rough_scale if self.is_rough else MOUNTING.scale
        return -below <= self.scale - 1.0 <= MOUNTING.scale

    @property
    def is_known(self) -> bool:
        """Whether enough was seen, and the speed explains it."""
        return (
            min(self.energy, self.force_energy) >= MOUNTING.energy
            and self.explained >= MOUNTING.explained
            and self.has_scale
        )


@dataclass(frozen=True, eq=False)
class TickTable:
    """Ticks of a drive in arrays, with the speed at the end of each."""

    stamp: FloatArray
    seconds: FloatArray
    """End and length of each tick. Shape (n,)."""
    force: ComplexArray
    """m/s² across up in the gyro's frame. Shape (n,)."""
    yaw: FloatArray
    turn_rate: FloatArray
    """Of the IMU in the frame, radians and rad/s. Shape (n,)."""
    speed: FloatArray
    """m/s; NaN where it is not known. Shape (n,)."""
    is_signed: bool = True  # whether backwards is negative


@dataclass(frozen=True, eq=False)
class _Filtered:
    force: ComplexArray
    change: ComplexArray
    swing: ComplexArray
    valid: BoolArray


def fit_mounting_yaw(ticks: TickTable, delay: float) -> MountingYaw | None:
    """Fit yaw, scale and lever arm; None where nothing moved.

    The speeds are already corrected by the latency `delay`, seconds.
    """
    if len(ticks.stamp) < MOUNTING.highpass // 2 or not np.isfinite(ticks.speed).any():
        return None
    signs = np.ones(len(ticks.stamp))
    filtered = _filtered(ticks, signs)
    if filtered.valid.sum() < MOUNTING.highpass // 4:
        return None
    if not ticks.is_signed:
        signs = _signs(ticks, filtered)
        filtered = _filtered(ticks, signs)
    return _solved(ticks, filtered, delay)


def correlation(ticks: TickTable) -> float:
    """Return how well force and change of velocity go together, zero to one."""
    change, valid = _change(ticks, np.ones(len(ticks.stamp)))
    force = _banded(np.where(valid, ticks.force, 0.0), valid)
    change = _banded(change, valid)
    size = math.sqrt(float(np.sum(np.abs(force) ** 2) * np.sum(np.abs(change) ** 2)))
    return 0.0 if size <= 0.0 else float(abs(np.vdot(change, force))) / size


def _change(ticks: TickTable, signs: FloatArray) -> tuple[ComplexArray, BoolArray]:
    """Return the change of velocity over each tick, m/s², and where it is known."""
    velocity = signs * ticks.speed * np.exp(1j * ticks.yaw)
    change = np.full(len(velocity), np.nan, dtype=np.complex128)
    change[1:] = (velocity[1:] - velocity[:-1]) / ticks.seconds[1:]
    valid = np.isfinite(change)
    gap = np.diff(ticks.stamp)
    valid[1:] &= np.abs(gap - ticks.seconds[1:]) < 0.5 * ticks.seconds[1:]
    return np.where(valid, change, 0.0), valid


def _filtered(ticks: TickTable, signs: FloatArray) -> _Filtered:
    change, valid = _change(ticks, signs)
    ends = 0.5 * (ticks.turn_rate + np.append(ticks.turn_rate[1:], ticks.turn_rate[-1]))
    look = 1j * ends * np.exp(1j * ticks.yaw)
    swing = np.zeros(len(look), dtype=np.complex128)
    swing[1:] = (look[1:] - look[:-1]) / ticks.seconds[1:]
    force, swing = (np.where(valid, x, 0.0) for x in (ticks.force, swing))
    force, change, swing = (_banded(x, valid) for x in (force, change, swing))
    return _Filtered(force, change, swing, valid)


def _banded(values: ComplexArray, valid: BoolArray) -> ComplexArray:
    counts = np.zeros(len(values) + 1, dtype=np.int64)
    np.cumsum(valid, out=counts[1:])
    low = _running(values, counts, MOUNTING.smooth)
    return np.where(valid, low - _running(values, counts, MOUNTING.highpass), 0.0)


def _running(values: ComplexArray, counts: IntArray, width: int) -> ComplexArray:
    """Return the mean over so many rows about each; `counts` are running ones of valid rows."""
    total = len(values)
    sums = np.zeros(total + 1, dtype=np.complex128)
    np.cumsum(values, out=sums[1:])
    last = np.minimum(np.maximum(np.arange(total) - width // 2, 0) + width, total)
    first = np.maximum(last - width, 0)
    return np.asarray((sums[last] - sums[first]) / np.maximum(counts[last] - counts[first], 1))


def trip_labels(speed: FloatArray, slowest: float) -> IntArray:
    """Return a number of the trip for each row, zero while the vehicle stands."""
    moving = np.abs(np.nan_to_num(speed)) > slowest
    begins = moving & ~np.r_[False, moving[:-1]]
    return np.asarray(np.where(moving, np.cumsum(begins), 0))


def _signs(ticks: TickTable, found: _Filtered) -> FloatArray:
    """Return plus or minus one per row: forwards where most of the way was driven.

    The squares of the trips' sums do not know the trips' signs.
    """
    label = trip_labels(ticks.speed, TRIP.standing)
    count = int(label.max()) + 1
    product = found.force * np.conj(found.change)
    sums = np.bincount(label, product.real, count) + 1j * np.bincount(label, product.imag, count)
    sums[0] = 0.0
    axis = cmath.exp(0.5j * cmath.phase(complex(np.sum(sums**2))))
    sign = np.where((sums * np.conj(axis)).real < 0.0, -1.0, 1.0)
    metres = np.bincount(label, np.abs(np.nan_to_num(ticks.speed)) * ticks.seconds, count)
    if float(sign @ metres) < 0.0:
        sign = -sign
    sign[0] = 1.0
    return np.asarray(sign[label])


class _Solution(NamedTuple):
    """Where the reweighted steps ended, and what they saw there."""

    z: complex
    noise: float
    weight: FloatArray
    error: ComplexArray
    scores: FloatArray
    information: FloatArray
    prior_score: float


def _solved(ticks: TickTable, found: _Filtered, delay: float) -> MountingYaw:
    rows = np.flatnonzero(found.valid)
    force, change, swing = (x[rows] for x in (found.force, found.change, found.swing))
    period = float(np.median(ticks.seconds))
    moving = np.abs(np.nan_to_num(ticks.speed)) > MOUNTING.moving
    seconds = float(np.sum(ticks.seconds[moving]))
    energy = float(np.sum(np.abs(change) ** 2)) * period
    force_energy = float(np.sum(np.abs(force) ** 2)) * period
    if energy <= 0.0:
        return MountingYaw(0.0, math.pi, 0.0, delay, 0.0, 0.0, force_energy, seconds, math.inf)
    end = _steps(force, change, swing)
    # A wild speed explains nothing, but is no worse than none.
    spent = float(np.sum(np.abs(force) ** 2))
    left = float(np.sum(np.minimum(np.abs(end.error) ** 2, np.abs(force) ** 2)))
    variance = _yaw_variance(end, ticks.stamp[rows])
    if seconds < MOUNTING.short:
        variance *= MOUNTING.widening**2
    return MountingYaw(
        -cmath.phase(end.z),
        min(math.pi, math.sqrt(variance + MOUNTING.floor**2)),
        abs(end.z),
        delay,
        1.0 - left / spent if spent > 0.0 else 0.0,
        energy,
        force_energy,
        seconds,
        end.noise,
    )


def _steps(force: ComplexArray, change: ComplexArray, swing: ComplexArray) -> _Solution:
    """Gauss-Newton on z and the lever arm, with weights 1/(1 + |e|²/4s²)."""
    z = complex(np.vdot(change, force)) / float(np.sum(np.abs(change) ** 2))
    lever = 0.0
    for _ in range(MOUNTING.iterations):
        error = force - z * (change + lever * swing)
        # The median of a Rayleigh distribution is 1.177 of its components' sigma.
        noise = max(1e-3, 1.26 * float(np.median(np.abs(error))))
        weight = 1.0 / (1.0 + np.abs(error) ** 2 / (4.0 * noise**2))
        model = change + lever * swing
        columns = np.array([model, 1j * model, z * swing])
        # Smoothed rows are correlated: the prior is weighed against independent ones.
        prior = noise**2 * MOUNTING.smooth / MOUNTING.lever_sigma**2
        information = np.real(columns.conj() * weight @ columns.T)
        information += np.diag([1e-9, 1e-9, prior])
        slope = np.real(columns.conj() @ (weight * error))
        slope[2] -= prior * lever
        step = np.linalg.solve(information, slope)
        z, lever = z + complex(step[0], step[1]), lever + float(step[2])
    error = force - z * (change + lever * swing)
    scores = np.real(columns.conj() * (weight * error))
    prior_score = (prior * MOUNTING.lever_sigma) ** 2
    return _Solution(z, noise, weight, error, scores, information, prior_score)


def _yaw_variance(end: _Solution, stamps: FloatArray) -> float:
    """Return the variance of the yaw by blocks of time whose errors are taken as one."""
    block = ((stamps - stamps[0]) / MOUNTING.block).astype(np.int64)
    sums = np.array([np.bincount(block, row) for row in end.scores])
    inverse = np.linalg.inv(end.information)
    covariance = inverse @ (sums @ sums.T + np.diag([0.0, 0.0, end.prior_score])) @ inverse
    across = np.array([-end.z.imag, end.z.real, 0.0]) / max(abs(end.z) ** 2, 1e-12)
    return float(across @ covariance @ across)
