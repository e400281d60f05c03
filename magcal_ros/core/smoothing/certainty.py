"""The covariance of the smoother's calibration: what a drive repeats is no news."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.calibration.heading_sigma import heading_jacobian, rms_sigma
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.smoothing.descent import Smoothed
from magcal_ros.core.smoothing.drive_model import (
    DOWN_FIELD,
    GYRO_BIAS,
    IRON,
    LEVEL_FIELD,
    PITCH,
    ROLL,
    SHARED,
    distortion,
)
from magcal_ros.core.smoothing.nodes import MICROTESLA, Means
from magcal_ros.core.smoothing.tuning import TUNING


@dataclass(frozen=True)
class CorrelationTuning:
    """How far correlation is looked for.

    Parameters
    ----------
    longest_lag : int
        Lags up to this fraction of the samples are looked at.
    least_power : float
        Mean square of a whitened residual vector below which the noise is taken as white.
    """

    longest_lag: int = 8
    least_power: float = 1.0


CORRELATION = CorrelationTuning()


def inefficiency_factor(residual: FloatArray, weight: FloatArray) -> float:
    """Return kappa = 1 + 2 sum of autocorrelations of whitened residuals.

    Real residuals are correlated in time; taken as independent, their number overrules every
    prior. The sum runs over the first lags whose correlation stands out of chance.

    Parameters
    ----------
    residual : ndarray, shape (n, k)
        Whitened residuals in the order of time.
    weight : ndarray, shape (n,)
        Samples with little weight are left out.

    Returns
    -------
    float
        One or more.
    """
    n = len(residual)
    size = 1 << (2 * n - 1).bit_length()
    lags = max(2, n // CORRELATION.longest_lag)
    spectrum = np.abs(np.fft.rfft(residual * weight[:, None], size, axis=0)) ** 2
    products = np.fft.irfft(spectrum.sum(axis=1), size)[:lags]
    pairs = np.fft.irfft(np.abs(np.fft.rfft(weight, size)) ** 2, size)[:lags]
    if products[0] <= 0.0:
        return 1.0
    mean_products = products / np.maximum(pairs, 1.0)
    # Residuals far below the noise that is assumed say nothing of its correlation.
    rho = (mean_products / max(float(mean_products[0]), CORRELATION.least_power))[1:]
    chance = 2.0 / np.sqrt(3.0 * max(float(weight.sum()), 1.0))
    below = np.flatnonzero(rho < chance)
    first_quiet = int(below[0]) if len(below) else len(rho)
    return float(max(1.0, 1.0 + 2.0 * rho[:first_quiet].sum()))


TILT = [ROLL, PITCH]
"""What a lean of up all along is taken for."""


@dataclass(frozen=True, eq=False)
class Twelve:
    """The calibration in the package's own form."""

    correction: Correction
    covariance: FloatArray
    """Of the twelve numbers, SI. Shape (12, 12)."""
    field: FloatArray
    """The Earth's in magnetic ENU, tesla. Shape (3,)."""
    heading_sigma: float
    """Radians on the level."""
    widened: float
    """By how much more uncertain it is than the model has it, at least one (variance)."""


def twelve_of(smoothed: Smoothed, to_sensor: FloatArray, strain: float = 1.0) -> Twelve:
    """Return the twelve numbers with their covariance.

    Parameters
    ----------
    smoothed : Smoothed
    to_sensor : ndarray, shape (3, 3)
        From nominal body axes to sensor axes, `Mounting.matrix`.
    strain : float
        How many times as uncertain it is besides, where it had to leave what was believed.
    """
    shared = smoothed.unknowns.shared
    correction = correction_of(shared, to_sensor)
    field = np.array([0.0, shared[LEVEL_FIELD], -shared[DOWN_FIELD]]) / MICROTESLA
    jacobian = _by_shared(shared, to_sensor)
    by_heading = heading_jacobian(correction, field, 0.0) @ jacobian
    plain = np.asarray(np.linalg.inv(smoothed.eliminated.information), dtype=np.float64)
    widened = strain**2 * _repeated(smoothed)
    least = _least_sigma(smoothed) / rms_sigma(by_heading, plain)
    widened = max(widened, least**2)
    of_shared = widened * plain
    of_shared[TILT, TILT] += _lean(smoothed) ** 2
    of_shared += _by_wander(smoothed, plain)
    covariance = jacobian @ of_shared @ jacobian.T
    sigma = rms_sigma(by_heading, of_shared)
    return Twelve(correction, 0.5 * (covariance + covariance.T), field, sigma, widened)


def correction_of(shared: FloatArray, to_sensor: FloatArray) -> Correction:
    """Return the correction of the shared numbers (14,), SI."""
    iron = to_sensor @ shared[IRON] / MICROTESLA
    return Correction(np.asarray(np.linalg.inv(to_sensor @ distortion(shared))), iron)


def _by_shared(shared: FloatArray, to_sensor: FloatArray) -> FloatArray:
    """Return the derivative of the twelve numbers by the shared ones, (12, 14)."""
    out = np.zeros((12, SHARED))
    for k in range(IRON.start, LEVEL_FIELD):
        step = 1e-3 if k < IRON.stop else 1e-5
        moved = [shared.copy(), shared.copy()]
        moved[0][k] += step
        moved[1][k] -= step
        high, low = (correction_of(each, to_sensor).parameters for each in moved)
        out[:, k] = (high - low) / (2.0 * step)
    return out


def _travels(smoothed: Smoothed) -> bool:
    """Tell whether the robot left its place."""
    return bool(smoothed.problem.nodes.metres.any())


def _repeated(smoothed: Smoothed) -> float:
    """Return how often the road went through the same places, at least one.

    Repeated passes of a street add no independent information. Where nobody travels, neighbours in
    time tell how much they repeat.
    """
    if not _travels(smoothed):
        residual = smoothed.here.field / smoothed.problem.noise
        return inefficiency_factor(residual, smoothed.here.weights[0])
    again = float(smoothed.problem.nodes.metres.sum()) / new_metres(smoothed)
    return min(max(1.0, again), TUNING.most_repeated)


def _least_sigma(smoothed: Smoothed) -> float:
    """Return the heading sigma, radians, below which no model of this drive may go.

    Who stays has one field for all, but for a little.
    """
    level = float(smoothed.unknowns.shared[LEVEL_FIELD])
    least = iron_by_streets(smoothed) if _travels(smoothed) else TUNING.lasting
    return least / level


def _lean(smoothed: Smoothed) -> float:
    """Return how far up may lean all along, with the robot, radians per axis, one sigma.

    In steady bends gyro bias and centripetal acceleration cannot be separated.
    """
    about_up = abs(float(smoothed.unknowns.shared[GYRO_BIAS]))
    return smoothed.problem.nodes.lean.sigma(about_up)


def _by_wander(smoothed: Smoothed, plain: FloatArray) -> FloatArray:
    """Return the covariance of the shared numbers by what is wrong with how up varies, (14, 14).

    As in every fit to a noisy input, what follows it is found too small: the downward field, which
    only leaning tells. The hard iron along up makes good for that; the level heading stays. Where
    the downward field was known before, little of it is told by leaning.
    """
    prior, wander = smoothed.problem.prior, smoothed.problem.nodes.lean.wander
    before = 1.0 / float(prior.information[DOWN_FIELD, DOWN_FIELD])
    by_leaning = max(1.0 - float(plain[DOWN_FIELD, DOWN_FIELD]) / before, 0.0)
    off = np.zeros(SHARED)
    # Of the field as it is likely to be: what was found is too small.
    off[DOWN_FIELD] = wander * by_leaning * math.hypot(float(prior.mean[DOWN_FIELD]), before**0.5)
    off[IRON] = off[DOWN_FIELD] * distortion(smoothed.unknowns.shared)[:, 2]
    return np.outer(off, off)


def new_metres(smoothed: Smoothed) -> float:
    """Return the length of road without what was driven again; cells of one reach are counted."""
    reach = TUNING.reach
    cells = _way(smoothed) // reach
    return reach * len(np.unique(cells.astype(int), axis=0))


def _way(smoothed: Smoothed) -> FloatArray:
    """Return the places of the nodes, reckoned from yaw and metres: east and north, (n, 2)."""
    return np.cumsum(smoothed.problem.nodes.metres[:, None] * _ahead(smoothed), axis=0)


def _ahead(smoothed: Smoothed) -> FloatArray:
    """Return where the nodes look, east and north, unit, shape (n, 2)."""
    return np.column_stack([np.cos(smoothed.unknowns.yaw), np.sin(smoothed.unknowns.yaw)])


def iron_by_streets(smoothed: Smoothed) -> float:
    """Return what streets let pass for hard iron, microtesla per level axis, one sigma.

    Seen from the world, hard iron turns with the yaw and the field of streets belongs to places:
    `exp(i psi) h + d(p)`. With the covariance of d between places, `exp(-distance / reach)` and
    small iron beside it, generalised least squares leave of h the variance `1 / (x^H K^-1 x)`,
    x = exp(i psi), here by its real and imaginary parts. Circles in one place leave little of the
    street, whose mean is no hard iron, and laps repeat what the first one told. Where the iron
    is not there yet, x is zero: such places only tell what their streets are.

    In a small place the calibration takes the bend for its own, so what was found of the street's
    size counts by its observations, two reaches of new road each, beside the usual size.
    """
    sizes = smoothed.problem.sizes
    observations = new_metres(smoothed) / (2.0 * TUNING.reach)
    found = smoothed.problem.street**2
    street = (observations * found + TUNING.usual_observations * TUNING.street**2) / (
        observations + TUNING.usual_observations
    )
    small = (TUNING.noise * max(sizes.noise, 1.0)) ** 2
    count = len(smoothed.unknowns.yaw)
    joined = math.ceil(count / TUNING.most_places)
    means = Means(np.arange(0, count, joined), count)
    has_iron = smoothed.problem.nodes.has_iron[:, None]
    way, ahead = means.of(_way(smoothed)), means.of(has_iron * _ahead(smoothed))
    apart = np.linalg.norm(way[:, None] - way, axis=2)
    covariance = street * np.exp(-apart / TUNING.reach)
    covariance += small * np.exp(-apart / TUNING.small_reach)
    covariance += TUNING.own_noise**2 / joined * np.eye(len(way))
    return 1.0 / math.sqrt(float(np.sum(ahead * np.linalg.solve(covariance, ahead))))
