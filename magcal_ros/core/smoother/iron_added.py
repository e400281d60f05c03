"""A change of hard iron during a drive: its time and its size.

A calibration is held. The hypothesis of no change, beyond the calibration's own uncertainty, is
compared with hard iron added at one moment. The gyro propagates the heading past this moment, so
that a jump of the compass is evidence. If the robot moves at that moment, a local disturbance on
its path is a third hypothesis; only the next turn can separate it from added iron.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import Correction
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
from magcal_ros.core.smoother.factors import magnetic
from magcal_ros.core.smoother.factors_of_motion import turned_by
from magcal_ros.core.smoother.fit import Fit, fit
from magcal_ros.core.smoother.kinds_of_motion import EVIDENCE_WEIGHT, mixture
from magcal_ros.core.smoother.model import path_between, solve_at
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.priors import Priors
from magcal_ros.core.smoother.state import State
from magcal_ros.core.smoother.unknowns import AT, KINDS, MICROTESLA, ON_WHEELS, STREET, UNKNOWNS

FEWEST_SINCE = 4  # nodes before and after the moment at which iron was added
STEEL_ODDS, STEEL_LENGTH = 300.0, 100.0
"""Prior odds of steel on the path (bridges, tunnels, garages) against iron added to the robot, and
the mean length of such a disturbance, metres."""


@dataclass(frozen=True, eq=False)
class IronChange:
    """A change of hard iron during a drive."""

    since: float  # time of the change, seconds
    gain: float  # log evidence ratio of a change against none, weighted by `EVIDENCE_WEIGHT`
    fit: DriveFit  # of the raw field since the change


def find_change(nodes: Nodes, calibration: Calibration, knowledge: Knowledge) -> IronChange | None:
    """Return the change of hard iron, at the time that explains the nodes best.

    `calibration` is that of the robot before the change. None if the drive is too short, or if no
    time of a change is likely.
    """
    if why_too_little(nodes) is not None:
        return None
    correction = calibration.correction
    inside = corrected(nodes, correction, knowledge.mounting.matrix)
    own = correction.matrix @ calibration.covariance[9:, 9:] @ correction.matrix.T
    # Over a drive, sensors and place have a constant error of the size of a drift.
    known = np.hypot(MICROTESLA * np.sqrt(np.maximum(np.diag(own), 0.0)), UNKNOWNS["drift"].sigma)
    priors = held_priors(inside, knowledge, known)
    same = held_fit(inside, priors)
    if same is None:
        return None
    # The change happens within its first node, or within the node before.
    within = {first - back for first in _moments(same) for back in (0, 1)}
    trials = [_changed(same, priors, "added", node) for node in sorted(within)]
    fits = [each for each in trials if each is not None]
    if not fits:
        return None
    best = min(fits, key=lambda each: each.evidence)
    node = int(np.searchsorted(inside.time, best.model.nodes.added_from))
    least = same.evidence
    # A disturbance that appears beside a resting robot does not follow the robot when it leaves.
    quiet = inside.quiet
    rests = quiet[node - 2 : node].any() and quiet[node + 1 : node + 3].any()
    if best.evidence < least and not rests:
        other = _changed(same, priors, "entered", node)
        if other is not None:
            way = float(np.sum(path_between(other.model, other.point)[node:]))
            least = min(least, other.evidence - 2.0 * (math.log(STEEL_ODDS) - way / STEEL_LENGTH))
    since = float(0.5 * (inside.time[node] + inside.time[node + 1]))
    gain = EVIDENCE_WEIGHT * (least - best.evidence)
    return IronChange(since, gain, _of_all_moments(correction, fits, best))


def _of_all_moments(correction: Correction, fits: list[Fit], best: Fit) -> DriveFit:
    """Return the best fit with the posterior of all, weighted by evidence.

    If the iron was added late in a node, the fit with the node before it is nearly as likely, and
    takes the mean field of the node for that after the change.
    """
    posteriors = {
        str(k): added_to(correction, each, AT["added"]).posterior for k, each in enumerate(fits)
    }
    worse = np.array([each.evidence - best.evidence for each in fits])
    odds = np.exp(-EVIDENCE_WEIGHT * worse)
    weights = dict(zip(posteriors, (odds / odds.sum()).tolist(), strict=True))
    return DriveFit(best, mixture(posteriors, weights, str(fits.index(best))))


def _changed(same: Fit, priors: Priors, name: str, node: int) -> Fit | None:
    """Return the fit with an effect that starts within a node and stays; None if it fails."""
    free = priors.with_scales({each: UNKNOWNS[each].sigma for each in (name, "came")})
    nodes = replace(same.model.nodes, added_from=float(same.model.nodes.time[node]))
    state = _begun(same, name, node)
    # The weights at the optimum without a change take the change for outliers.
    like = replace(same, point=replace(same.point, state=state, is_robust=False))
    return fit(nodes, free, state, KINDS[ON_WHEELS], TOLERANCES, like)


def _moments(same: Fit) -> set[int]:
    """Return the likely first nodes of a change, by a score test; often none.

    About the optimum without a change the cost is quadratic. Let g and I be gradient and
    information of iron added at a node, with all other unknowns marginalised: the iron lowers the
    cost by g^T I^-1 g, and the evidence also contains the determinant of I. A jump that is
    absorbed as an outlier of the local disturbance has no gradient; its cost as an outlier is a
    second criterion.
    """
    weighted, solution = solve_at(same.model, same.point)
    part, count = weighted["field"], len(same.model.nodes)
    weight, free = part.weight[:, None, None], same.model.free
    since = np.arange(FEWEST_SINCE, count - FEWEST_SINCE)
    later = np.arange(count)[:, None] >= since
    by_node = np.swapaxes(weight * part.linear.by_node, 1, 2)
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
    street = weighted["street"]
    jump = street.misfits[since - 1] - street.linear.residual.shape[1]
    narrower = np.linalg.slogdet(own * np.square(UNKNOWNS["added"].sigma))[1]
    gains = gain - narrower, jump - narrower
    return {int(since[np.argmax(each)]) for each in gains if each.max() > 0.0}


def _begun(same: Fit, name: str, node: int) -> State:
    """Return the start of the fit: attitude by the gyro after the change, no local disturbance."""
    state, nodes = same.state, same.model.nodes
    shared, local, attitude = state.shared.copy(), state.local.copy(), state.attitude.copy()
    steps = np.where(
        nodes.is_tied[:, None, None],
        turned_by(nodes, shared),
        attitude[1:] @ np.swapaxes(attitude[:-1], 1, 2),
    )
    attitude[node:] = chained(steps[None, node:])[0] @ attitude[node]
    local[node:, STREET] = 0.0
    changed = replace(state, attitude=attitude, local=local, shared=shared)
    residual = magnetic(same.point.course, changed, same.point.places).residual
    if name == "entered":
        residual = np.einsum("nji,nj->ni", attitude, residual)
    shared[AT[name]] = np.median(residual[node + 1 :], axis=0)
    return replace(changed, shared=shared)
