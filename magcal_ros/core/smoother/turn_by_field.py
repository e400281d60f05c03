"""A turn without a gyro: each geometric solution is fitted and weighted by its evidence.

The sense of rotation is that of a magnetometer whose z is less than a quarter turn off its
nominal pose: nothing but a gyro shows one that is mounted upside down.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.fit import Fit, Tolerances, fit
from magcal_ros.core.smoother.kinds_of_motion import Smoothed, is_possible, mixed
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.posterior import posterior
from magcal_ros.core.smoother.priors import Priors, priors_of
from magcal_ros.core.smoother.state import Course, State
from magcal_ros.core.smoother.unknowns import KINDS, ON_THE_SPOT, SMALL_CIRCLE
from magcal_ros.core.smoother.without_gyro import (
    apart,
    guesses,
    in_a_bent_field,
    in_a_circle,
    nodes_by_field,
    without_rates,
)

NOTHING_FITS = "no installation and hard iron fit these samples; check the axes and repeat the turn"
OTHER = ", other root"
USUAL = {SMALL_CIRCLE: 0.1}
USUAL |= {name + OTHER: share for name, share in USUAL.items()}
"""How usual kinds of motion are without a gyro, which alone would show them, over the usual one."""
AGAIN = Tolerances(fewest=4)  # from the optimum of another kind of motion
SKETCH = Tolerances(rounds=5, fewest=5)  # rounds that are enough to rank the starts
ROOTS = 2  # starts that are followed to the end
RIVAL = 0.05  # probability from which another root is a rival
APART = 0.05  # radians of installation and hard iron over the field by which two starts are two
FURTHEST, HOPELESS = 60.0, 30.0
"""Of minus twice the logarithm of the evidence over the best one's: starts that are worse after a
few rounds are dropped, and solutions that are worse at their optimum have no weight."""


def smooth_by_field(window: Window, knowledge: Knowledge) -> Smoothed:
    """Fit a turn without a gyro, from every geometric solution for axis, circle and dip.

    Raises `Refusal` if no fit converges.
    """
    nodes = nodes_by_field(window, knowledge.mounting.to_body)
    usual = priors_of(knowledge)
    assert nodes.tied_to is not None
    rests = bool(Course.of(nodes, nodes.tied_to, np.zeros(3), usual.lengths).still.any())
    priors = without_rates(usual, rests=rests)
    led = (_upright(like.model.priors, like) for like in _best(nodes, priors, knowledge))
    roots = _distinct([each for each in led if each is not None], HOPELESS)
    if not roots:
        raise Refusal(Reason.NO_SOLUTION, NOTHING_FITS)
    fits: dict[str, Fit] = {}
    for each, root in zip(roots, ("", OTHER), strict=False):
        # Sensors that are exact move no more than their robot does.
        found = {ON_THE_SPOT: each} if knowledge.exact_sensors else _elsewhere(each)
        fits |= {name + root: other for name, other in found.items()}
    return mixed(fits, roots[0].model.nodes, knowledge, USUAL)


def _elsewhere(first: Fit) -> dict[str, Fit]:
    """Fit a turn again with a field gradient, on the spot and in a small circle.

    The field of an open place is one that bends by nothing, not another kind of motion.
    """
    # A field that bends looks like axes out of square, which are square to begin with.
    groups = {**first.point.groups, "axes": 1.0, "soft_iron": 1.0}
    like = replace(first, point=replace(first.point, groups=groups))
    spot = _upright(in_a_bent_field(first.model.priors), like) or first
    circle = _upright(in_a_circle(spot.model.priors), spot)
    if circle is None:
        return {ON_THE_SPOT: spot}
    if circle.evidence < spot.evidence:
        # The sizes of the noises may have gone on to shrink there.
        again = _upright(spot.model.priors, circle)
        spot = again if again is not None and again.evidence < spot.evidence else spot
    return {ON_THE_SPOT: spot, SMALL_CIRCLE: circle}


def _upright(priors: Priors, like: Fit) -> Fit | None:
    """Return the fit of a turn from another optimum; None if it fails or mirrors the axes."""
    found = _fitted(like.model.nodes, priors, like.state, AGAIN, like)
    # While the field is taken for uniform, soft iron of any size explains its gradient.
    return found if found is not None and is_possible(found, math.inf) else None


def _distinct(fits: list[Fit], furthest: float) -> list[Fit]:
    """Return the distinct fits with an evidence near the best one's, the best first."""
    kept: list[Fit] = []
    for each in sorted(fits, key=lambda fit: fit.evidence):
        new = all(apart(each.state, other.state) > APART for other in kept)
        if new and each.evidence < (kept or [each])[0].evidence + furthest:
            kept.append(each)
    return kept


def _fitted(
    nodes: Nodes, priors: Priors, state: State, tolerances: Tolerances, like: Fit | None = None
) -> Fit | None:
    """Return the fit of a turn; None if a matrix is not positive definite."""
    try:
        return fit(nodes, priors, state, KINDS[ON_THE_SPOT], tolerances, like)
    except np.linalg.LinAlgError:
        return None


def _best(nodes: Nodes, priors: Priors, knowledge: Knowledge) -> list[Fit]:
    """Return the distinct starts of the highest evidence after a few rounds, the best first."""
    led = [
        _fitted(turning, about, state, SKETCH)
        for turning, state, about in guesses(nodes, priors, knowledge.reference)
    ]
    return _distinct([each for each in led if each is not None], FURTHEST)[:ROOTS]


def rival_gap(found: Smoothed) -> float:
    """Return the heading between the solutions of a turn, radians; zero if only one fits."""
    by_root: dict[bool, str] = {}
    for name in sorted(found.weights, key=found.weights.__getitem__):
        by_root[name.endswith(OTHER)] = name
    if len(by_root) < 2 or min(found.weights[name] for name in by_root.values()) < RIVAL:
        return 0.0
    one, other = (posterior(found.fits[name], np.eye(3)) for name in by_root.values())
    return one.apart(other)
