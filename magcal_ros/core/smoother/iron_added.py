"""A change of hard iron during a drive: its time and its size.

A calibration is held. That nothing changed, beyond what the calibration itself is uncertain by, is
compared with a hard iron that is there from one moment on. The heading goes through that moment by
the gyro, so the compass' own jump counts, and a straight road shows the iron before the next turn
does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.geometry.rotations import chained
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoother.drives import (
    TOLERANCES,
    DriveFit,
    added_to,
    corrected,
    held_fit,
    held_priors,
    why_too_little,
)
from magcal_ros.core.smoother.factors import magnetic, turned_by
from magcal_ros.core.smoother.fit import Fit, fit
from magcal_ros.core.smoother.kinds_of_motion import BELIEVED
from magcal_ros.core.smoother.model import course_at, solve_at
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.state import State
from magcal_ros.core.smoother.unknowns import AT, KINDS, MICROTESLA, ON_WHEELS, STREET, UNKNOWNS

FEWEST_SINCE = 4
"""Nodes before and after the moment at which iron was added."""
TRIED = 2
"""Moments at which it is tried, the most likely ones."""
LASTING = 0.15
"""µT that sensors and a place err by all along a stretch in which nothing moves."""


@dataclass(frozen=True, eq=False)
class IronChange:
    """A change of hard iron during a drive."""

    since: float
    """Clock from which it is there, seconds."""
    gain: float
    """Log evidence ratio of a change against none, times `BELIEVED`."""
    fit: DriveFit
    """Of the raw field since then."""


def find_change(nodes: Nodes, calibration: Calibration, knowledge: Knowledge) -> IronChange | None:
    """Return the change of hard iron, at the time that explains the nodes best.

    The calibration is the one before the change. None if the drive is too short, or if no time of a
    change explains the nodes better.
    """
    if why_too_little(nodes) is not None:
        return None
    correction = calibration.correction
    inside = corrected(nodes, correction, knowledge.mounting.matrix)
    own = correction.matrix @ calibration.covariance[9:, 9:] @ correction.matrix.T
    known = np.hypot(MICROTESLA * np.sqrt(np.maximum(np.diag(own), 0.0)), LASTING)
    priors = held_priors(knowledge, known)
    same = held_fit(inside, priors)
    if same is None:
        return None
    scale = priors.scale.copy()
    scale[AT["added"]] = UNKNOWNS["added"].sigma
    free, best = replace(priors, scale=scale), None
    for since in _moments(same):
        changed = replace(inside, added_from=since)
        try:
            found = fit(changed, free, _begun(same, changed), KINDS[ON_WHEELS], TOLERANCES)
        except np.linalg.LinAlgError:
            continue
        if best is None or found.evidence < best.evidence:
            best = found
    if best is None:
        return None
    gain = BELIEVED * (same.evidence - best.evidence)
    fitted = added_to(correction, best, AT["added"])
    return IronChange(best.model.nodes.added_from, gain, fitted)


def _moments(same: Fit) -> list[float]:
    """Return the likely times of a change, by a score test at each node; often none.

    The cost is quadratic about the optimum without a change: with the gradient g by iron that is
    there since a node and the information I, all other unknowns integrated out, it falls by
    g^T I^-1 g. The evidence has the determinant of I besides.
    """
    weighted, solution = solve_at(same.model, same.point)
    part, count = weighted["field"], len(same.model.nodes)
    weight, free = part.weight[:, None, None], same.model.free
    since = np.arange(FEWEST_SINCE, count - FEWEST_SINCE)
    later = np.arange(count)[:, None] >= since
    by_node = np.swapaxes(weight * part.linear.here, 1, 2)
    right = by_node[:, :, None, :] * later[:, None, :, None]
    flat = right.reshape(count, by_node.shape[1], -1)
    solved = solution.chain.solve(flat).reshape(right.shape)
    own = np.einsum("n,nk->k", part.weight, later)[:, None, None] * np.eye(3)
    own -= np.einsum("nlki,nlkj->kij", right, solved)
    shared = part.linear.by(free)
    follow = solution.follow[:, :, : shared.shape[2]]
    cross = np.einsum("nis,nk->ksi", weight * shared, later)
    cross -= np.einsum("nls,nlki->ksi", follow, right)
    spread = solution.covariance[: shared.shape[2], : shared.shape[2]]
    own -= np.swapaxes(cross, 1, 2) @ spread @ cross
    own += np.diag(np.array(UNKNOWNS["added"].sigma) ** -2.0)
    gradient = np.einsum("n,ni,nk->ki", part.weight, part.linear.residual, later)
    gain = np.einsum("ki,ki->k", gradient, np.linalg.solve(own, gradient[:, :, None])[:, :, 0])
    gain -= np.linalg.slogdet(own * np.square(UNKNOWNS["added"].sigma))[1]
    chosen: list[int] = []
    for row in np.argsort(-gain)[: np.count_nonzero(gain > 0.0)]:
        if all(abs(row - other) >= FEWEST_SINCE for other in chosen):
            chosen.append(int(row))
        if len(chosen) == TRIED:
            break
    time = same.model.nodes.time
    return [float(0.5 * (time[since[row] - 1] + time[since[row]])) for row in chosen]


def _begun(same: Fit, nodes: Nodes) -> State:
    """Return the start of the fit: attitude by the gyro after the change, no local disturbance."""
    state = same.state
    shared, local, attitude = state.shared.copy(), state.local.copy(), state.attitude.copy()
    first = int(np.searchsorted(nodes.time, nodes.added_from, side="right"))
    steps = np.where(
        nodes.is_tied[:, None, None],
        turned_by(nodes, shared),
        attitude[1:] @ np.swapaxes(attitude[:-1], 1, 2),
    )
    attitude[first - 1 :] = chained(steps[None, first - 1 :])[0] @ attitude[first - 1]
    local[first:, STREET] = 0.0
    places = same.model.no_places
    begun = State(attitude, local, shared)
    course = course_at(same.model, begun)
    residual = magnetic(replace(course, nodes=nodes), begun, places).residual
    shared[AT["added"]] = np.median(residual[first:], axis=0)
    return State(attitude, local, shared)
