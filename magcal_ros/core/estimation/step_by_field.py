"""By how much the field is another in motion than at rest, where no gyro tells the heading.

A rest beside the turn must lie on the turn's own path: what it lies off, up and field together, the
robot adds when it moves. Along the path the heading gives way, so of three numbers one rest shows
two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.estimation.solver import Fit
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.rotations import minimal_rotation, rotation_about
from magcal_ros.core.samples.rest import RestBeside


@dataclass(frozen=True)
class StepRule:
    """When a rest lies off the turn's path by more than chance.

    Parameters
    ----------
    near : float
        Radians of heading within which the turn's own residuals are taken off.
    fewest : int
        Samples there.
    tilt : float
        Radians by which up at rest and in motion may differ by what is no lean, 1 sigma.
    sigmas : float
        From which a step is more than chance.
    smallest : float
        Tesla below which none is worth a word.
    rounds : int
        Of the search for the heading at rest.
    shown : float
        Share of the best shown direction's weight from which another counts as shown.
    """

    near: float = math.radians(30.0)
    fewest: int = 5
    tilt: float = math.radians(0.1)
    sigmas: float = 3.0
    smallest: float = 0.2e-6
    rounds: int = 4
    shown: float = 0.1


RULE = StepRule()


@dataclass(frozen=True, eq=False)
class _Off:
    """How far a rest lies off the path (3,), field scales, which part it shows, and its sigma."""

    step: FloatArray
    shows: FloatArray
    sigma: float


def step_by_field(fit: Fit, rests: tuple[RestBeside, ...], scale: float) -> FloatArray | None:
    """Return how much more field there is in motion than at rest.

    Parameters
    ----------
    fit : Fit
        The optimum of one turn.
    rests : tuple of RestBeside
    scale : float
        Tesla of one field scale.

    Returns
    -------
    ndarray, shape (m, 3), or None
        Tesla, in the magnetometer's axes: what is seen, then one sigma along each direction that
        no rest shows, taken for as large as the others. Zero where chance explains it, None where
        nothing tells.
    """
    seen = [off for rest in rests if (off := _off_the_path(fit, rest, scale)) is not None]
    if not seen:
        return None
    weights = sum((off.shows / off.sigma**2 for off in seen), np.zeros((3, 3)))
    told = sum((off.step / off.sigma**2 for off in seen), np.zeros(3))
    value, axes = np.linalg.eigh(weights)
    shown = value > RULE.shown * value[-1]
    along = axes[:, shown].T @ told / value[shown]
    fall = float(np.sum(value[shown] * along**2))
    step, usual = scale * (axes[:, shown] @ along), scale * float(np.sqrt(np.mean(along**2)))
    if fall < RULE.sigmas**2 * shown.sum() or np.linalg.norm(step) < RULE.smallest:
        return np.zeros((1, 3))
    return np.concatenate([step[None], usual * axes[:, ~shown].T])


def _off_the_path(fit: Fit, rest: RestBeside, scale: float) -> _Off | None:
    block = fit.block
    place, shared = block.place, block.place.state.shared
    prediction, raw = place.prediction, rest.field / scale
    nearest = int(np.argmin(np.linalg.norm(place.samples.field - raw, axis=1)))
    up = shared.body_axis.T @ unit(rest.force)
    field = minimal_rotation(unit(prediction.up[nearest]), up) @ prediction.field[nearest]
    for _ in range(RULE.rounds):
        off = raw - shared.hard_iron - prediction.field_matrix @ field
        along = prediction.field_matrix @ np.cross(up, field)
        turn = float(along @ off / (along @ along))
        field = rotation_about(up, np.array([turn]))[0] @ field
    heading = np.arctan2(prediction.field @ np.cross(up, field), prediction.field @ field)
    near = (np.abs(heading) < RULE.near) & block.weighting.inliers
    if near.sum() < RULE.fewest:
        return None
    count = max(float(near.sum()) / block.weighting.inefficiency, 1.0)
    sigma = math.hypot(
        block.weighting.noise.field / math.sqrt(count),
        rest.field_sigma / scale,
        RULE.tilt * abs(shared.strength),
    )
    shows = np.eye(3) - np.outer(along, along) / (along @ along)
    return _Off(shows @ (prediction.field_residual[near].mean(axis=0) - off), shows, sigma)
