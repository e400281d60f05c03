"""A turn without a gyro: each geometric solution is fitted and weighted by its evidence.

The field shows the turn rate about the turn's axis, which is used only to average samples to nodes.
The attitudes of neighbouring nodes are linked because the robot turns about a fixed axis and sways,
so that up changes slowly in body axes.

The sense of rotation follows from a magnetometer whose z is within a quarter turn of its nominal
direction; only a gyro could show that it is mounted upside down.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, interpolated
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.rotations import minimal_rotation
from magcal_ros.core.geometry.shapes import fit_circle_robustly
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.spikes import without_spikes
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.factors import Z
from magcal_ros.core.smoother.fit import Fit, Tolerances, fit, without_distortion
from magcal_ros.core.smoother.kinds_of_motion import Smoothed, is_possible, mixture_of_kinds
from magcal_ros.core.smoother.nodes import Nodes, Spacing, nodes_of
from magcal_ros.core.smoother.posterior import posterior
from magcal_ros.core.smoother.priors import Priors, priors_of
from magcal_ros.core.smoother.start import starts_by_field
from magcal_ros.core.smoother.state import Course, State
from magcal_ros.core.smoother.unknowns import (
    AT,
    EARTH,
    KINDS,
    MICROTESLA,
    ON_THE_SPOT,
    PASSED,
    ROLL_PITCH,
    SMALL_CIRCLE,
)

NOTHING_FITS = "no installation and hard iron fit these samples; check the axes and repeat the turn"
OTHER = ", other root"
USUAL = {SMALL_CIRCLE: 0.1, PASSED: 0.05}
USUAL |= {name + OTHER: share for name, share in USUAL.items()}
"""Prior weights of the kinds of motion without a gyro, which alone could distinguish them."""
RESTART = Tolerances(fewest=4)  # from the optimum of another kind of motion
RANKING = Tolerances(rounds=5, fewest=5)  # rounds that are enough to rank the starts
SMOOTHED = 0.5
"""Seconds (one sigma) over which the angle of the field is averaged for the turn rate."""
SWAY_SMOOTHED = 0.1
"""Seconds (one sigma) over which the force is averaged for the rate of the sway: a robot that sways
may tilt by `Spacing.most_turn` (RMS) during a node."""
ROOTS = 2  # starts that are iterated to the end
RIVAL = 0.05  # probability from which another root is a rival
DISTINCT = 0.05  # least distance of distinct solutions: radians, and hard iron over the field
STARTS_WITHIN, ROOTS_WITHIN = 60.0, 30.0
"""Largest difference of minus twice the log evidence from the best one: of starts after a few
rounds, and of solutions at their optimum. The others are dropped."""


def nodes_by_field(window: Window, to_body: FloatArray) -> Nodes:
    """Return the nodes of a window without a gyro, with the turn rate from the field."""
    window = window.take(without_spikes(window.field) & without_spikes(window.specific_force))
    field = window.field @ to_body.T * MICROTESLA
    circle = fit_circle_robustly(field)
    usual = unit(np.median(window.specific_force, axis=0))
    axis = circle.normal * math.copysign(1.0, float(circle.normal @ usual))
    turn = np.unwrap(circle.phase(field)) * math.copysign(1.0, float(circle.normal @ usual))
    rate = np.gradient(-_smooth(window.time, turn[:, None], SMOOTHED), window.time, axis=0) * axis
    made = replace(window, angular_rate=rate, missed=None)
    nodes = nodes_of(made, to_body, Spacing(longest=_longest(window)))
    return replace(nodes, tied_to=minimal_rotation(Z, axis))


def _longest(window: Window) -> float:
    """Return the duration of a node in which a robot sways by at most `Spacing.most_turn`, RMS."""
    up = unit(_smooth(window.time, window.specific_force, SWAY_SMOOTHED))
    rate = np.linalg.norm(np.gradient(up, window.time, axis=0), axis=1)
    steady, spacing = math.sqrt(float(np.mean(rate**2))), Spacing()
    return min(spacing.short, spacing.most_turn / max(steady, 1e-9))


def _smooth(time: FloatArray, values: FloatArray, seconds: float) -> FloatArray:
    """Return values averaged over some seconds to both sides, about a straight line."""
    step = max(float(np.median(np.diff(time))), (time[-1] - time[0]) / 2000.0)
    grid = np.arange(time[0], time[-1] + step, step)
    rows = interpolated(grid, time, values)
    reach = max(1, min(round(3.0 * seconds / step), (len(grid) - 1) // 2))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step / seconds) ** 2)
    padded = np.pad(rows, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = np.stack(
        [np.convolve(axis, kernel / kernel.sum(), mode="valid") for axis in padded.T], axis=1
    )
    return interpolated(time, grid, smooth)


def smooth_by_field(window: Window, knowledge: Knowledge) -> Smoothed:
    """Fit a turn without a gyro, from every geometric solution for axis, circle and dip.

    Raises `Refusal` if no fit is possible.
    """
    nodes = nodes_by_field(window, knowledge.mounting.to_body)
    usual = priors_of(knowledge)
    assert nodes.tied_to is not None
    rests = bool(Course.of(nodes, nodes.tied_to, np.zeros(3), usual.lengths).still.any())
    priors = usual.without_rates(rests=rests)
    led = (_upright(like.model.priors, like) for like in _best(nodes, priors, knowledge))
    roots = _distinct([each for each in led if each is not None], ROOTS_WITHIN)
    if not roots:
        raise Refusal(Reason.NO_SOLUTION, NOTHING_FITS)
    fits: dict[str, Fit] = {}
    for each, root in zip(roots, ("", OTHER), strict=False):
        found = _with_something_passing(each) if knowledge.exact_sensors else _with_gradient(each)
        fits |= {name + root: other for name, other in found.items()}
    return mixture_of_kinds(fits, roots[0].model.nodes, knowledge, USUAL)


def _with_gradient(first: Fit) -> dict[str, Fit]:
    """Fit a turn again with a field gradient, on the spot and in a small circle.

    A uniform field is not another kind of motion, but the special case of a zero gradient.
    """
    # A gradient resembles non-orthogonal axes, so that these start as orthogonal.
    like = without_distortion(first)
    spot = _upright(first.model.priors.in_a_gradient, like) or first
    circle = _upright(spot.model.priors.in_a_circle, spot)
    if circle is None:
        return {ON_THE_SPOT: spot}
    if circle.evidence < spot.evidence:
        # The noise sizes may have shrunk further in the circle's fit.
        again = _upright(spot.model.priors, circle)
        spot = again if again is not None and again.evidence < spot.evidence else spot
    return {ON_THE_SPOT: spot, SMALL_CIRCLE: circle}


def _with_something_passing(usual: Fit) -> dict[str, Fit]:
    """Return a fit of exact sensors, and that of the same turn with something that passes."""
    priors = usual.model.priors.with_something_passing
    passed = _upright(priors, without_distortion(usual))
    return {ON_THE_SPOT: usual} | ({} if passed is None else {PASSED: passed})


def _upright(priors: Priors, like: Fit) -> Fit | None:
    """Return the fit of a turn from another optimum; None if it fails or mirrors the axes."""
    nodes, state = like.model.nodes, like.state
    found = fit(nodes, priors, state, KINDS[ON_THE_SPOT], RESTART, like)
    # With the field assumed uniform, soft iron of any size may explain its gradient.
    return found if found is not None and is_possible(found, math.inf) else None


def _distinct(fits: list[Fit], furthest: float) -> list[Fit]:
    """Return the distinct fits whose evidence is near the best, in order of evidence."""
    kept: list[Fit] = []
    for each in sorted(fits, key=lambda fit: fit.evidence):
        new = all(state_distance(each.state, other.state) > DISTINCT for other in kept)
        if new and each.evidence < (kept or [each])[0].evidence + furthest:
            kept.append(each)
    return kept


def _best(nodes: Nodes, priors: Priors, knowledge: Knowledge) -> list[Fit]:
    """Return the distinct starts of the highest evidence after a few rounds, in order."""
    up = unit(_smooth(nodes.time, nodes.mean_force, SMOOTHED))
    led = [
        fit(turning, about, state, KINDS[ON_THE_SPOT], RANKING)
        for turning, state, about in starts_by_field(nodes, up, priors, knowledge.reference)
    ]
    return _distinct([each for each in led if each is not None], STARTS_WITHIN)[:ROOTS]


def rival_gap(found: Smoothed) -> float:
    """Return the difference of heading between two solutions, radians; zero if only one fits."""
    by_root: dict[bool, str] = {}
    for name in sorted(found.weights, key=found.weights.__getitem__):
        by_root[name.endswith(OTHER)] = name
    if len(by_root) < 2 or min(found.weights[name] for name in by_root.values()) < RIVAL:
        return 0.0
    one, other = (posterior(found.fits[name], np.eye(3)) for name in by_root.values())
    return one.distance_to(other)


def state_distance(one: State, other: State) -> float:
    """Return the larger difference: of installation (radians), or of hard iron over the field."""
    off = np.abs(one.shared - other.shared)
    field = float(np.linalg.norm(one.shared[EARTH]))
    return float(max(off[ROLL_PITCH].max(), off[AT["iron"]].max() / field))
