"""The calibration fitted to the truth: no calibration of a recording can be better."""

from __future__ import annotations

import math

import numpy as np
import shared_cases  # noqa: F401
from recorded_truth import LEAST_SCORED, STEEPEST, Drive

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import level_part, unit, yaw_from_up_and_field

SCATTER = 3e-6
"""Tesla per axis by which streets bend the field, usually."""
WITNESSES = 100.0
"""As many places were passed, however many samples there are."""
FREE = 0.05
"""How far each of the nine numbers may be from those of the calibration compared."""
ROUNDS, FREEDOM = 20, 8.0


def told_by_truth(
    drive: Drive, like: Correction, span: tuple[float, float] = (-math.inf, math.inf)
) -> Correction | None:
    """Return the twelve numbers that explain a recording's field best where its yaw is known.

    Least squares of the raw field against that of the Earth as truth and up turn it, reweighted
    by Student's t. What truth leaves open, yaw but for a constant and the size of the field, is
    taken from the calibration compared.

    Parameters
    ----------
    drive : Drive
    like : Correction
        The calibration that is compared.
    span : tuple of float
        First and last stamp of the samples that are looked at, seconds.

    Returns
    -------
    Correction or None
        None without a truth there.
    """
    truth = drive.truth
    if truth is None:
        return None
    everything, up = drive.everything, drive.up
    time = everything.time + drive.delay
    first, last = truth.time[0], truth.time[-1]
    seen = (time >= first) & (time <= last) & (up[:, 2] > np.cos(STEEPEST))
    seen &= (everything.time >= span[0]) & (everything.time <= span[1])
    rows = np.flatnonzero(seen)
    if len(rows) < LEAST_SCORED:
        return None
    up, raw = up[rows], everything.field[rows]
    yaw = np.interp(time[rows], truth.time, np.unwrap(truth.yaw))
    found = yaw_from_up_and_field(up, like.apply(raw))
    yaw += float(np.angle(np.mean(np.exp(1j * (found - yaw)))))
    field = _earth_in_body(up, yaw, like.apply(raw))
    return _fitted(field, raw, like)


def _earth_in_body(up: FloatArray, yaw: FloatArray, corrected: FloatArray) -> FloatArray:
    """Return the Earth's field in body axes (n, 3), as large as the corrected one is."""
    ahead = unit(level_part(np.tile([1.0, 0.0, 0.0], (len(up), 1)), up))
    north = np.sin(yaw)[:, None] * ahead + np.cos(yaw)[:, None] * np.cross(up, ahead)
    level = float(np.median(np.linalg.norm(level_part(corrected, up), axis=1)))
    rise = float(np.median(np.sum(corrected * up, axis=1)))
    return np.asarray(level * north + rise * up)


def _fitted(field: FloatArray, raw: FloatArray, like: Correction) -> Correction:
    """Regress raw = M field + h about the matrix that undoes `like`."""
    start = np.linalg.inv(like.matrix)
    design = np.column_stack([field, np.ones(len(field))])
    scale = WITNESSES / len(field) / SCATTER**2
    prior = np.diag([*np.full(3, FREE**-2), 0.0])
    left = raw - field @ start.T
    weight = np.ones(len(field))
    for _ in range(ROUNDS):
        normal = scale * (design.T * weight) @ design + prior
        moved = np.linalg.solve(normal, scale * (design.T * weight) @ left)
        square = np.sum((left - design @ moved) ** 2, axis=1) / SCATTER**2
        weight = (FREEDOM + 3.0) / (FREEDOM + square)
    return Correction(np.linalg.inv(start + moved[:3].T), moved[3])
