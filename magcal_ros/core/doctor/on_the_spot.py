"""Whether a robot turned on the spot, by what it feels while it turns.

An IMU that is a metre from the axis of a turn feels the rate squared, in m/s². A vehicle that
drives through a bend feels more. It comes to another place there, where the field is another one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.doctor.explanations import TUNING as WEIGHED
from magcal_ros.core.doctor.latency import TUNING as LATENCY
from magcal_ros.core.doctor.latency import fit_of_the_force, rows_in
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, running_mean, runs
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit
from magcal_ros.core.samples.alignment import BIAS, PARAMETERS
from magcal_ros.core.samples.window import SensorLog


@dataclass(frozen=True)
class SpotTuning:
    """How the felt acceleration of a turn is compared with that at rest."""

    mean: float = 0.5  # seconds over which rates and forces are averaged
    at_rest: float = 1.5  # seconds at the ends of a rest that show gravity
    longest: float = 10.0  # seconds from a rest within which the gyro's attitude is believed
    drift: float = math.radians(0.1)
    lean: float = math.radians(0.2)
    """rad/s of the bias that is read at rest, and radians of an attitude: standard deviations."""
    offset: float = 0.3  # m/s², standard deviation of the accelerometer's
    independent: float = 5.0  # samples that all of a turn count for, as what is felt lasts
    beyond: float = 2.0  # times what a turn on the spot explains


TUNING = SpotTuning()


def drove_while_turning(
    log: SensorLog, gyro: FloatArray = np.eye(3), bias: FloatArray = np.zeros(3)
) -> bool:
    """Return whether the robot felt more than a turn on the spot explains; False if not shown.

    The log has a gyro, whose axes are the rows of `gyro` (3, 3) in the body's; `bias` (3,) is
    roughly that of its rates, rad/s.
    """
    fit = fit_of_the_force(log, gyro)
    if fit is None:
        return False
    part, rate = fit.stretch, fit.rate[0]
    turned, up = rate - bias, unit(np.median(log.force, axis=0))
    width = rows_in(TUNING.mean, part.time)
    still = running_mean(np.linalg.norm(turned, axis=1), width) < LATENCY.turns
    about_up = running_mean(turned @ up, width)
    rests = _ends_of_rests(still, rows_in(TUNING.at_rest, part.time))
    if not rests:
        return False
    away = np.abs(part.time[:, None] - part.time[[edge for edge, _ in rests]])
    nearest, since = np.argmin(away, axis=1), away.min(axis=1)
    seen = (np.abs(about_up) > LATENCY.turns) & (since < TUNING.longest)
    if seen.sum() * max(float(np.median(np.diff(part.time))), 1e-4) < TUNING.mean:
        return False
    state = np.zeros((1, PARAMETERS))
    state[:, BIAS] = np.median(rate[still], axis=0)
    attitude = fit.propagate(state)[0][0]
    force = np.column_stack([running_mean(axis, width) for axis in part.size * part.field.T])
    world = np.einsum("nji,nj->ni", attitude, force)
    gravity = np.array([world[rows].mean(axis=0) for _, rows in rests])
    to_world = np.array([attitude[rows].mean(axis=0).T for _, rows in rests])
    felt = force[seen] - np.einsum("nij,nj->ni", attitude[seen], gravity[nearest[seen]])
    unsure = STANDARD_GRAVITY * np.hypot(TUNING.drift * since[seen], TUNING.lean)
    allowed = np.hypot(WEIGHED.lever * about_up[seen] ** 2, unsure)
    left = _without_offset(felt, attitude[seen] @ to_world[nearest[seen]], up, allowed)
    return bool(np.median(np.linalg.norm(left, axis=1) / allowed) > TUNING.beyond)


def _ends_of_rests(still: BoolArray, width: int) -> list[tuple[int, slice]]:
    """Return the first and the last row of each rest, each with the rows that show gravity."""
    found = []
    for first, end in runs(still):
        if end - first >= min(width, 3):
            found.append((first, slice(first, min(first + width, end))))
            found.append((end - 1, slice(max(end - width, first), end)))
    return found


def _without_offset(
    felt: FloatArray, turned: FloatArray, up: FloatArray, sigma: FloatArray
) -> FloatArray:
    """Return what is felt on the level, (n, 3), less what an accelerometer's offset explains."""
    # The offset was taken for a part of gravity at rest, and turned (n, 3, 3) with it since.
    level = np.eye(3) - np.outer(up, up)
    seen = felt @ level
    design = level @ (np.eye(3) - turned)
    share = TUNING.independent / len(felt)
    rows = share * design / sigma[:, None, None] ** 2
    normal = np.einsum("nji,njk->ik", rows, design) + np.eye(3) / TUNING.offset**2
    offset = np.linalg.solve(normal, np.einsum("nji,nj->i", rows, seen))
    return np.asarray(seen - design @ offset)
