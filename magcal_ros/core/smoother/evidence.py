"""The evidence of a model, by Laplace's approximation."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from magcal_ros.core.smoother.model import CHANGES, Model, Point
from magcal_ros.core.smoother.solver import Solution, Weighted
from magcal_ros.core.smoother.unknowns import ACCELERATION, AT, BODY_FIELD, STREET, VELOCITY


def evidence(
    model: Model, point: Point, weighted: dict[str, Weighted], solution: Solution
) -> float:
    """Return minus twice the logarithm of the evidence by Laplace's approximation.

    But for a constant of the window; the sizes are at their most likely values.
    """
    by_shared = cost_of_shared(model, point) + solution.log_determinant
    return cost_of_nodes(model, point, weighted) + by_shared


def cost_of_nodes(model: Model, point: Point, weighted: dict[str, Weighted]) -> float:
    """Return minus twice the log of likelihood and priors, except those of shared unknowns."""
    state, sizes, places = point.state, point.sizes, point.places
    cost = sum(part.cost for part in weighted.values())
    levels = (
        (VELOCITY, model.speed),
        (STREET, sizes["street"]),
        (BODY_FIELD, point.body_field_at_first),
        (ACCELERATION, np.array([sizes[name] for name in CHANGES])),
    )
    for which, level in levels:
        cost += float(np.sum((state.local[0, which] / level) ** 2 + 2.0 * np.log(level)))
    # A rest is a measurement of the velocity.
    creep = model.priors.lengths.creep
    rests = state.local[point.course.still, VELOCITY] / creep
    cost += float(np.sum(rests**2)) + 2.0 * rests.size * math.log(creep)
    centres = state.centres / sizes["street"]
    cost += float(np.sum(places.information * (centres @ centres.T)))
    cost += 3.0 * (places.log_determinant + 2.0 * len(places) * math.log(sizes["street"]))
    for name, belief in model.priors.sizes.items():
        cost += (math.log(sizes[name] / belief.usual) / belief.spread) ** 2
    return cost


def cost_of_shared(model: Model, point: Point, names: Iterable[str] = tuple(AT)) -> float:
    """Return minus twice the log prior of some groups of shared unknowns."""
    off, scales, cost = point.state.shared - model.priors.mean, model.scales(point.groups), 0.0
    known: dict[str, float] = {}
    for name in names:
        at = AT[name]
        if name == "earth":
            earth = model.priors.earth
            cost += float(off[at] @ np.linalg.solve(earth, off[at]) + np.linalg.slogdet(earth)[1])
            excess, sigma, _ = model.priors.beyond_strongest(point.state.shared[at])
            cost += (excess / sigma) ** 2
            continue
        seen = scales[at] > 0.0
        scale = scales[at][seen]
        cost += float(np.sum((off[at][seen] / scale) ** 2 + 2.0 * np.log(scale)))
        if model.priors.spread[name] > 0.0:
            # The factor of crooked axes follows from that of the distortion.
            if name != "axes":
                x = np.log([point.groups[name]])
                cost -= 2.0 * float(model.priors.log_density(name, x, known)[0])
            known[name] = point.groups[name]
    return cost
