"""A turn without a gyro: each way in which axis, circle and dip fit together is fitted and weighed.

The sense of rotation is that of a magnetometer whose z is less than a quarter turn off its
nominal pose: nothing but a gyro shows one that is mounted upside down.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.fit import Fit, Tolerances, fit
from magcal_ros.core.smoother.kinds_of_motion import NO_SOLUTION, Smoothed, is_upright, mixed
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.posterior import posterior
from magcal_ros.core.smoother.state import State
from magcal_ros.core.smoother.unknowns import (
    AT,
    KINDS,
    ON_THE_SPOT,
    SMALL_CIRCLE,
    Priors,
    priors_of,
)
from magcal_ros.core.smoother.without_gyro import (
    HEIGHT,
    apart,
    at_height,
    guesses,
    in_a_circle,
    nodes_by_field,
    without_rates,
)

SWAYING, OTHER = "on the spot, swaying", ", other root"
USUAL = {SMALL_CIRCLE: 0.1, SWAYING: 0.5}
USUAL |= {name + OTHER: share for name, share in USUAL.items()}
"""How usual kinds of motion are without a gyro, which alone would show them, over the usual one."""
AGAIN = Tolerances(fewest=4)
"""From the optimum of another kind of motion."""
SKETCH = Tolerances(rounds=5, fewest=5)
"""Enough to tell good starts from bad ones."""
ROOTS = 2
"""Starts that are followed to the end."""
RIVAL = 0.05
"""Probability from which another root is a rival."""
APART = 0.05
"""Radians of installation and hard iron over the field by which two starts are two."""
FURTHEST = 60.0
"""Of minus twice the logarithm of the evidence; starts that are worse after a few rounds lead
nowhere."""


def smooth_by_field(window: Window, knowledge: Knowledge) -> Smoothed:
    """Fit a turn that has no gyro, from every way in which axis, circle and dip fit together.

    Raises
    ------
    Refusal
        If no fit could be had.
    """
    nodes = nodes_by_field(window, knowledge.mounting.to_body)
    priors = without_rates(priors_of(knowledge), knowledge.systematics)
    fits: dict[str, Fit] = {}
    for number, (state, about) in enumerate(_best(nodes, priors, knowledge)):
        root = "" if number == 0 else OTHER
        found = _of_one_root(nodes, about, state, is_exact=knowledge.systematics.are_none)
        fits |= {name + root: each for name, each in found.items()}
    if not fits:
        raise Refusal(Reason.NO_SOLUTION, NO_SOLUTION)
    return mixed(fits, nodes, knowledge, USUAL)


def _of_one_root(nodes: Nodes, priors: Priors, state: State, *, is_exact: bool) -> dict[str, Fit]:
    """Fit a turn on the spot, with an accelerometer high above the pivot, and in a small circle.

    One after the other: begun with a height, the fit may take all lean for sway. Sensors that are
    exact move no more than their robot does, so that a small circle is not tried.
    """
    found: dict[str, Fit] = {}

    def follow(name: str, about: Priors, like: Fit | None, tolerances: Tolerances) -> None:
        each = _fitted(nodes, about, state, tolerances, like)
        if each is not None and is_upright(each):
            found[name] = each

    follow(ON_THE_SPOT, priors, None, Tolerances())
    if not found:
        return found
    raised = raised_to(found[ON_THE_SPOT], HEIGHT)
    follow(SWAYING, at_height(priors, HEIGHT), raised, AGAIN)
    if not is_exact:
        best = min(found.values(), key=lambda each: each.evidence)
        height = float(best.state.shared[AT["height"]][0])
        follow(SMALL_CIRCLE, in_a_circle(at_height(priors, height)), best, AGAIN)
    return found


def _fitted(
    nodes: Nodes, priors: Priors, state: State, tolerances: Tolerances, like: Fit | None = None
) -> Fit | None:
    """Fit a turn; None where a matrix is not positive definite."""
    try:
        return fit(nodes, priors, state, KINDS[ON_THE_SPOT], tolerances, like)
    except np.linalg.LinAlgError:
        return None


def raised_to(fit: Fit, height: float) -> Fit:
    """Return a fit as a start for another height of the accelerometer, metres."""
    shared = fit.state.shared.copy()
    shared[AT["height"]] = height
    return replace(fit, point=replace(fit.point, state=replace(fit.state, shared=shared)))


def _best(nodes: Nodes, priors: Priors, knowledge: Knowledge) -> list[tuple[State, Priors]]:
    """Return the distinct starts that lead furthest in a few rounds, the best one first."""
    led = [
        (found, about)
        for state, about in guesses(nodes, priors, knowledge.reference)
        if (found := _fitted(nodes, about, state, SKETCH)) is not None
    ]
    led.sort(key=lambda pair: pair[0].evidence)
    kept: list[tuple[Fit, Priors]] = []
    for each, about in led:
        new = all(apart(each.state, other.state) > APART for other, _ in kept)
        if new and each.evidence < led[0][0].evidence + FURTHEST and len(kept) < ROOTS:
            kept.append((each, about))
    return [(each.state, about) for each, about in kept]


def rival_gap(found: Smoothed) -> float:
    """Return radians of heading between the roots of a turn; zero where the samples choose one."""
    by_root: dict[bool, str] = {}
    for name in sorted(found.weights, key=found.weights.__getitem__):
        by_root[name.endswith(OTHER)] = name
    if len(by_root) < 2 or min(found.weights[name] for name in by_root.values()) < RIVAL:
        return 0.0
    one, other = (posterior(found.fits[name], np.eye(3)) for name in by_root.values())
    return one.apart(other)
