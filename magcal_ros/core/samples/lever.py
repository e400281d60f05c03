"""Gravity in the specific force of a moving sensor, without lever arm or linear acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, block_means, trapezoids
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, usual_size
from magcal_ros.core.geometry.rotations import chained, exp_rotations, skews
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class LeverTuning:
    """The prior of the lever arm, and how it is fitted."""

    arm: float = 1.0  # metres, standard deviation of the lever arm along each axis
    noise: float = 1e-3  # m/s², least noise of the length of the specific force
    wide: float = 3.0  # sigmas of this length from which a sample loses weight
    rounds: int = 20
    most: int = 5000  # samples that are fitted
    fewest: int = 20
    seconds: float = 4.0  # of one mean; a hand changes its velocity by little over this time


TUNING = LeverTuning()


def gravity_size(time: FloatArray, force: FloatArray, rate: FloatArray | None) -> float:
    """Return the size of gravity in specific forces (n, 3), m/s² as published.

    The acceleration of the sensor is unknown. A lever arm adds to single samples, and linear
    acceleration changes their lengths but not their mean over some seconds, in axes that do not
    rotate. Of both sizes the one nearer to gravity is returned: a difference that motion explains
    is not the accelerometer's. Without a gyro the usual length of the samples is returned.

    `time` (n,) increases, seconds. `rate` (n, 3) is in rad/s.
    """
    if rate is None or len(time) < TUNING.fewest:
        return usual_size(force)
    sizes = usual_size(force_on_the_axis(time, force, rate)), _size_of_means(time, force, rate)
    return min(sizes, key=lambda size: abs(size - STANDARD_GRAVITY))


def _size_of_means(time: FloatArray, force: FloatArray, rate: FloatArray) -> float:
    """Return the usual length of the means of specific forces in axes that do not rotate."""
    path = chained(exp_rotations(-trapezoids(time, rate))[None])[0]
    count = max(1, round(float(time[-1] - time[0]) / TUNING.seconds))
    first = np.unique(np.searchsorted(time, np.linspace(time[0], time[-1], count + 1)[:-1]))
    return usual_size(block_means(np.einsum("nij,ni->nj", path, force), first))


def without_lever_arm(window: Window) -> FloatArray:
    """Return the specific force without the part due to the lever arm, m/s², shape (n, 3).

    The lever arm is fitted so that the length of the specific force is most constant, which needs
    rates but no attitude. Without a gyro, or if the sensor turns too slowly to show a lever arm,
    the measured force is returned.
    """
    force, rate = window.specific_force, window.angular_rate
    return force if rate is None else force_on_the_axis(window.time, force, rate)


def force_on_the_axis(time: FloatArray, force: FloatArray, rate: FloatArray) -> FloatArray:
    """Return specific forces (n, 3) without the part due to the lever arm, m/s².

    `time` (n,) increases, seconds. `rate` (n, 3) is in rad/s.
    """
    if len(time) < TUNING.fewest:
        return force
    spin = skews(rate)
    per_metre = skews(np.gradient(rate, time, axis=0)) + spin @ spin
    some = slice(None, None, 1 + len(time) // TUNING.most)
    return np.asarray(force - per_metre @ _lever_arm(force[some], per_metre[some]))


def _lever_arm(force: FloatArray, per_metre: FloatArray) -> FloatArray:
    """Fit a lever arm (3,) and gravity's length by robust least squares, with a prior."""
    state = np.array([0.0, 0.0, 0.0, usual_size(force)])
    prior = np.array([1.0, 1.0, 1.0, 0.0]) / TUNING.arm**2
    for _ in range(TUNING.rounds):
        left = force - per_metre @ state[:3]
        size = np.linalg.norm(left, axis=1)
        off = size - state[3]
        along = np.einsum("ni,nij->nj", left / np.maximum(size, 1e-9)[:, None], per_metre)
        slope = np.column_stack([-along, -np.ones(len(size))])
        sigma = 1.4826 * float(np.median(np.abs(off))) + TUNING.noise
        weighted = slope.T / (sigma**2 + (off / TUNING.wide) ** 2)
        information = weighted @ slope + np.diag(prior)
        state = state - np.linalg.solve(information, weighted @ off + prior * state)
    return np.asarray(state[:3])
