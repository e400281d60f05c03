"""Iron that was added on the way: when, and how much, by one likelihood ratio.

A calibration is held. That nothing changed, beyond what the calibration itself is uncertain by, is
compared with a hard iron that is there from one moment on. The yaw goes through that moment by the
gyro, so the compass' own jump counts, and a straight road shows the iron before the next turn does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoothing.descent import Problem, Sizes, Smoothed, descend, smooth
from magcal_ros.core.smoothing.drive_model import (
    GYRO_BIAS,
    IRON,
    Unknowns,
    field_of,
    free_prior,
    held_prior,
    turned_into,
)
from magcal_ros.core.smoothing.fit import DriveFit, added_to, aligned, corrected
from magcal_ros.core.smoothing.nodes import MICROTESLA, Nodes
from magcal_ros.core.smoothing.tuning import TUNING, SmootherTuning


@dataclass(frozen=True, eq=False)
class IronChange:
    """Iron that was added."""

    since: float
    """Clock from which it is there, seconds."""
    gain: float
    """Fall of minus twice the log likelihood against no change, over `counts`."""
    fit: DriveFit
    """Its `twelve` is of the raw field since then."""


def find_change(
    nodes: Nodes, calibration: Calibration, knowledge: Knowledge, tuning: SmootherTuning = TUNING
) -> IronChange | None:
    """Find the moment from which iron that was added explains the nodes best.

    Parameters
    ----------
    nodes : Nodes
    calibration : Calibration
        In force before.
    knowledge : Knowledge
    tuning : SmootherTuning

    Returns
    -------
    IronChange or None
        None where too little was driven, or no moment explains anything.
    """
    if len(nodes) < tuning.fewest_for_iron or nodes.tied_share < tuning.least_tied:
        return None
    correction = calibration.correction
    inside = corrected(nodes, correction, knowledge.mounting.matrix)
    own = MICROTESLA**2 * correction.matrix @ calibration.covariance[9:, 9:] @ correction.matrix.T
    before = _problem(inside, knowledge, own + tuning.lasting**2 * np.eye(3), tuning)
    unmoved = Unknowns(before.prior.mean.copy(), inside.heading, np.zeros((len(inside), 3)))
    same = descend(before, aligned(unmoved, inside))
    if same is None:
        return None
    best: Smoothed | None = None
    free = np.eye(3) * tuning.hard_iron**2
    for since in _moments(inside, tuning):
        found = descend(
            _problem(replace(inside, iron_from=since), knowledge, free, tuning),
            _begun(same, since),
        )
        if found is not None and (best is None or found.here.cost < best.here.cost):
            best = found
    if best is None or best.here.cost >= same.here.cost:
        return None
    gain = (same.here.cost - best.here.cost) / tuning.counts
    sized = smooth(best.problem, best.unknowns, reviews=2)
    if sized is None:
        return None
    fit = DriveFit(sized, added_to(correction, sized), 0.0)
    return IronChange(best.problem.nodes.iron_from, gain, fit)


def _problem(
    inside: Nodes, knowledge: Knowledge, iron: FloatArray, tuning: SmootherTuning
) -> Problem:
    """Return the problem with nothing free but the hard iron (covariance, µT²), field and gyro."""
    prior = held_prior(free_prior(knowledge, tuning), iron=True)
    covariance = prior.covariance.copy()
    covariance[IRON, IRON] = iron
    declination = knowledge.reference.declination or 0.0
    return Problem(inside, replace(prior, covariance=covariance), declination, Sizes(), tuning)


def _moments(inside: Nodes, tuning: SmootherTuning) -> list[float]:
    """Return when iron may have come: the largest steps of the field, and moments between them.

    The field of a node is predicted from the one before and the gyro.
    """
    level = np.einsum("nji,nj->ni", inside.axes, inside.field)
    there = np.einsum("nij,nj->ni", turned_into(inside.turned[1:]), level[:-1])
    # A node in which it came is a mixture, and the step is then between its neighbours.
    over_two = np.einsum("nij,nj->ni", turned_into(inside.turned[2:]), there[:-1])
    steps = np.linalg.norm(level[1:] - there, axis=1)
    wide = np.linalg.norm(level[2:] - over_two, axis=1)
    size = np.maximum(steps, np.append(wide, 0.0))
    last = len(inside) - tuning.fewest_since
    # Neither the nodes before nor the nodes since may be too few to tell one from the other.
    rows = 1 + np.argsort(-size[: max(last - 1, 0)])[: tuning.steps_tried]
    between = np.arange(tuning.fewest_since, last, tuning.moments_apart)
    return [float(time) for time in inside.time[np.unique(np.concatenate([rows, between]))]]


def _begun(same: Smoothed, since: float) -> Unknowns:
    """Return where to start: the yaw follows the gyro from there, and no street is known yet."""
    problem, before = same.problem, same.unknowns
    nodes = replace(problem.nodes, iron_from=since)
    later = nodes.has_iron > 0.0
    first = int(np.argmax(later))
    street, shared = before.street.copy(), before.shared.copy()
    street[first:] = 0.0
    shared[IRON] = 0.0
    yaw = before.yaw.copy()
    steps = nodes.turned - shared[GYRO_BIAS] * nodes.seconds
    yaw[first:] = yaw[first - 1] + np.cumsum(steps[first:])
    start = Unknowns(shared, yaw, street)
    shared[IRON] = np.median((nodes.field - field_of(nodes, start))[later], axis=0)
    return start
