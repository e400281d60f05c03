"""Compass against gyro over stretches through which the gyro propagates the heading."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.calibration.estimate import GyroSwing
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.attitude import wrap_angle
from magcal_ros.core.monitoring.recheck_tuning import RecheckTuning
from magcal_ros.core.samples.coverage import COVERAGE, Coverage
from magcal_ros.core.samples.streams import STREAMS
from magcal_ros.core.samples.window import Window


def gyro_compass(
    window: Window, up: FloatArray, yaw: FloatArray, heading: FloatArray, tuning: RecheckTuning
) -> tuple[GyroSwing, IntArray] | None:
    """Compare gyro and compass over a window; return how the compass swings, and in which rows.

    None where there is nothing to compare.

    Parameters
    ----------
    window : Window
        The samples.
    up : ndarray, shape (n, 3)
        Unit, body axes.
    yaw, heading : ndarray, shape (n,)
        By the compass that is tried, and where the robot looked as far as is known; radians.
    tuning : RecheckTuning
    """
    pieces = _pieces(window, up, tuning)
    if window.angular_rate is None or not pieces:
        return None
    across = np.maximum(1.0 - up[:, 0] ** 2, 1.0 - tuning.steepest_nose)
    rate = np.sum(window.angular_rate[:, 1:] * up[:, 1:], axis=1) / across
    steps = 0.5 * np.diff(window.time) * (rate[1:] + rate[:-1])
    turned = np.concatenate([[0.0], np.cumsum(steps)])
    error = compass_less_gyro(window.time, yaw, turned, heading, pieces)
    rms = math.sqrt(float(np.mean(error**2)))
    rows = np.concatenate(pieces)
    return GyroSwing(heading[rows], error, rms), rows


def compass_less_gyro(
    time: FloatArray,
    yaw: FloatArray,
    turned: FloatArray,
    heading: FloatArray,
    pieces: list[IntArray],
) -> FloatArray:
    """Return compass less gyro, one offset a piece and one steady bias removed.

    Each sample is compared by itself, as an angle: beside iron that takes away the level field the
    compass may go once round by itself, and is right again afterwards. The gyro's bias turns far
    less than that within a piece.

    Over a single turn an error that comes and goes with the heading looks like a bias in part:
    the bias is found beside two harmonics of the heading, and only the bias is removed. Less
    than a turn cannot tell them apart.

    Parameters
    ----------
    time, yaw, turned, heading : ndarray, shape (n,)
        Seconds; radians by the compass, by the gyro, and where the robot looked as far as known.
    pieces : list of ndarray of int
        Rows over which the gyro propagates the heading.

    Returns
    -------
    ndarray
        Radians in (-pi, pi], the pieces one after another.
    """
    orders = (1, 2) if Coverage.of(heading).is_complete else ()
    waves = [wave(k * heading) for k in orders for wave in (np.cos, np.sin)]
    basis = np.column_stack([time, *waves])
    design, residuals = [], []
    for rows in pieces:
        gap = yaw[rows] - turned[rows]
        residual = wrap_angle(gap - np.angle(np.mean(np.exp(1j * gap))))
        residuals.append(residual - residual.mean())
        design.append(basis[rows] - basis[rows].mean(axis=0))
    a, b = np.concatenate(design), np.concatenate(residuals)
    bias = float(np.linalg.lstsq(a, b, rcond=None)[0][0])
    bias = min(max(bias, -COVERAGE.largest_gyro_bias), COVERAGE.largest_gyro_bias)
    return wrap_angle(b - bias * a[:, 0])


def _pieces(window: Window, up: FloatArray, tuning: RecheckTuning) -> list[IntArray]:
    """Return the stretches of rows over which gyro and compass are compared."""
    good = up[:, 0] ** 2 < tuning.steepest_nose
    spell = np.floor((window.time - window.time[0]) / tuning.longest_piece)
    unheard = np.diff(window.time) > STREAMS.longest_gyro_step
    parted = unheard | (np.diff(spell) > 0) | ~good[1:] | ~good[:-1]
    pieces = np.split(np.arange(len(window)), np.flatnonzero(parted) + 1)
    return [rows for rows in pieces if len(rows) > 2]
