"""Whether the gyro turns the way the accelerometer sees gravity turn."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class GyroSignsTuning:
    """When a gyro is said to contradict the accelerometer.

    Parameters
    ----------
    span : float
        Seconds over which turns are compared: shorter ones drown in noise, longer ones in bias.
    contradicts : float
        Share of gravity's changes that a gyro at odds with them leaves at least: it makes more
        of them than there was.
    explained : float
        Share that other signs may leave at most; the rest is a hand's acceleration.
    """

    span: float = 0.5
    contradicts: float = 1.5
    explained: float = 0.6


def gyro_contradicts(window: Window, tuning: GyroSignsTuning = GyroSignsTuning()) -> bool:
    """Return whether axes of the gyro turn against gravity, whichever they are.

    A body that turns by a small angle d sees up change by -d x up. On the level nothing of it
    shows, and nothing is said.
    """
    if window.angular_rate is None or len(window) < 3:
        return False
    steps = np.diff(window.time)
    turned = np.zeros((len(window), 3))
    mean = 0.5 * (window.angular_rate[1:] + window.angular_rate[:-1])
    turned[1:] = np.cumsum(mean * steps[:, None], axis=0)
    later = np.searchsorted(window.time, window.time + tuning.span)
    first = np.flatnonzero(later < len(window))
    last = later[first]
    near = window.time[last] - window.time[first] < 2.0 * tuning.span
    first, last = first[near], last[near]
    if not len(first):
        return False
    up = unit(window.specific_force)
    seen, middle, turn = up[last] - up[first], up[last] + up[first], turned[last] - turned[first]
    left = {
        signs: float(np.sum((seen + np.cross(turn * signs, 0.5 * middle)) ** 2))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    }
    best = min(left.values())
    changes = float(np.sum(seen**2))
    as_given = left[1.0, 1.0, 1.0]
    return as_given > tuning.contradicts * changes and best < tuning.explained * changes
