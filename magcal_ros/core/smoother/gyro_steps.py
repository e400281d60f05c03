"""Increments of angle and velocity between the samples of a window."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, trapezoids
from magcal_ros.core.samples.streams import SWAY
from magcal_ros.core.samples.window import Window


def gyro_steps(window: Window) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the IMU's increments from each sample to the next, (n - 1, ...).

    Angles, radians; the variances of their errors; the velocity by the specific force in body axes,
    m/s; and the number of IMU intervals over which these were integrated.

    Over m intervals the error of the trapezoidal rule is smaller by m**2 than over one
    (Euler-Maclaurin), and the variance of the angle that the samples miss is smaller by m**5.
    """
    time, rate = window.time, window.angular_rate
    assert rate is not None
    turned, unseen = _turned(time, rate)
    angle, velocity, intervals = window.steps
    many = np.maximum(intervals, 1.0)[:, None]  # zero where the IMU sent no sample
    return (
        angle + (turned - trapezoids(time, rate)) / many**2,
        unseen / many**5,
        velocity,
        intervals,
    )


def _turned(time: FloatArray, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the angles between samples, radians, and the variances of their errors, (n - 1, 3).

    A polynomial through six samples underestimates sway near the Nyquist frequency, and the fit
    would compensate with a stronger field. At such sample rates the rate is interpolated as a
    signal band-limited to the fastest sway.
    """
    usual = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    if SWAY / 3.0 < usual < SWAY and len(time) > 2:
        steps, unseen = _band_limited(time, rate)
        # Band-limited interpolation would extrapolate sway into a gap.
        hole = np.flatnonzero(np.diff(time) > SWAY)
        steps[hole] = trapezoids(time, rate)[hole]
        unseen[hole] = _unseen_angles(time, rate)[hole]
        return steps, unseen
    bend, twist = np.zeros_like(rate), np.zeros_like(rate)
    bend[1:-1] = np.diff(rate, 2, axis=0)
    twist[2:-2] = np.diff(rate, 4, axis=0)
    value = rate - bend / 12.0 + twist * (11.0 / 720.0)
    return trapezoids(time, value), _unseen_angles(time, rate)


def _band_limited(time: FloatArray, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Integrate rates as a Gaussian process: a constant plus white power up to the fastest sway."""
    size, level, noise = min(12, len(time)), 30.0, 1e-3
    row = np.arange(len(time) - 1)
    rows = np.clip(row - size // 2 + 1, 0, len(time) - size)[:, None] + np.arange(size)
    at, step = time[rows] - time[row][:, None], np.diff(time)[:, None]
    place, weight = np.polynomial.legendre.leggauss(4)
    inside, share = 0.5 * (place + 1.0) * step, 0.5 * weight * step

    def alike(first: FloatArray, second: FloatArray) -> FloatArray:
        return np.asarray(np.sinc((first[:, :, None] - second[:, None, :]) / SWAY) + level)

    along = np.einsum("nq,nqj->nj", share, alike(inside, at))
    weights = np.linalg.solve(alike(at, at) + noise * np.eye(size), along[:, :, None])[:, :, 0]
    whole = np.einsum("nq,nqp,np->n", share, alike(inside, inside), share)
    missed = np.maximum(whole - np.einsum("nj,nj->n", weights, along), 0.0)
    power = np.zeros_like(rate)
    # The second difference of white noise has six times its variance.
    power[1:-1] = np.diff(rate, 2, axis=0) ** 2 / 6.0
    unseen = 0.5 * missed[:, None] * (power[:-1] + power[1:])
    return np.einsum("nj,njk->nk", weights, rate[rows]), unseen


def _unseen_angles(time: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the variances of the angles between samples, radians², shape (n - 1, 3).

    Between slow samples, a body may sway as much as from sample to sample. The variance is exact if
    the samples show only sway that is too fast for them, and so looks like white noise.

    `time` (n,) is in seconds, `rate` (n, 3) in rad/s.
    """
    step = np.diff(time)[:, None]
    square = np.zeros_like(rate)
    square[1:-1] = np.diff(rate, 2, axis=0) ** 2
    share = np.minimum(step / SWAY, 1.0) ** 4
    return np.asarray(share * step**2 * (square[:-1] + square[1:]) / 24.0)
