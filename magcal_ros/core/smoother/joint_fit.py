"""Joint fit of several turns of one robot: each has its own nodes, and all share the calibration.

The iterations start from the separate fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.smoother.fit import Fit, Tolerances, optimum
from magcal_ros.core.smoother.joint import (
    Layout,
    is_own,
    own_groups,
    prior_of_common,
    rows_of,
    with_factors,
)
from magcal_ros.core.smoother.model import (
    Model,
    Point,
    counted_unknowns,
    prior_at,
    solve_at,
    weigh,
)
from magcal_ros.core.smoother.solver import Solution, solve
from magcal_ros.core.smoother.unknowns import AT, NOTHING, SHARED, STREET, TURNED, UNKNOWNS


@dataclass(frozen=True, eq=False)
class JointFit:
    """The optimum of several windows."""

    fits: list[Fit]  # of each window, given all windows; with the joint evidence
    informations: list[FloatArray]
    """Information of each window on the common unknowns. Shape (SHARED, SHARED)."""
    prior: FloatArray  # prior information on the common unknowns. Shape (SHARED, SHARED).
    evidence: float  # minus twice the logarithm of the evidence, up to a constant of the windows


def information_of(model: Model, point: Point, solution: Solution) -> FloatArray:
    """Return a window's information on the shared unknowns, (SHARED, SHARED)."""
    counted = counted_unknowns(model, point.places)
    own = is_own(model, counted)
    inside, cross, out = np.ix_(~own, ~own), np.ix_(~own, own), np.zeros((SHARED, SHARED))
    whole = solution.information
    by_own = whole[cross] @ np.linalg.solve(whole[np.ix_(own, own)], whole[cross].T)
    left = whole[inside] - by_own - prior_at(model, point).information[inside]
    out[np.ix_(counted[~own], counted[~own])] = 0.5 * (left + left.T)
    return out


def imagined_information(fit: Fit, body: FloatArray, world: FloatArray) -> FloatArray:
    """Return the expected information of the same turn at another tilt, (SHARED, SHARED).

    The robot is rotated by `world` (3, 3) in world axes, then by `body` (3, 3) in its own axes.
    """
    state, turned = fit.state, fit.point.course.nodes.in_axes(body)
    model = replace(fit.model, nodes=turned)
    point = replace(
        fit.point,
        state=replace(state, attitude=body @ state.attitude @ world),
        course=replace(fit.point.course, nodes=turned),
    )
    expected = [part.imagined for part in weigh(model, point).values()]
    counted = counted_unknowns(model, point.places)
    return information_of(model, point, solve(expected, prior_at(model, point), counted))


def fit_jointly(
    alone: Sequence[Fit], yaw_sigma: float, tolerances: Tolerances = Tolerances()
) -> JointFit:
    """Return the joint fit of windows that share the calibration, from the fits of each.

    `yaw_sigma` is the prior sigma of the installation's yaw, radians, which is observable with
    several tilts. Raises `numpy.linalg.LinAlgError` if a matrix is not positive definite.
    """
    models = _with_one_prior([each.model for each in alone], yaw_sigma)
    found = optimum(models, _from_one_start(models, alone), tolerances)
    windows = zip(models, found.wide, found.widened.solutions, strict=True)
    informations = [information_of(*each) for each in windows]
    prior = prior_of_common(models, found.wide)
    fits = found.fits([each.kind for each in alone])
    return JointFit(fits, informations, prior, found.evidence)


def _with_one_prior(models: Sequence[Model], yaw_sigma: float) -> list[Model]:
    """Return models with the same priors of the common unknowns: the widest of each."""
    scale = np.stack([model.priors.scale for model in models]).max(axis=0)
    scale[TURNED] = yaw_sigma
    first, out = models[0].priors, []
    for model in models:
        own = rows_of(own_groups(model))
        its_scale, its_mean = scale.copy(), first.mean.copy()
        its_scale[own], its_mean[own] = model.priors.scale[own], model.priors.mean[own]
        if model.priors.sizes["street"].usual > NOTHING:
            its_scale[AT["place"]] = UNKNOWNS["place"].sigma
        priors = replace(model.priors, scale=its_scale, mean=its_mean, fields=first.fields)
        out.append(replace(model, priors=priors, earth=models[0].earth))
    return out


def _from_one_start(models: Sequence[Model], alone: Sequence[Fit]) -> list[Point]:
    """Return each window's optimum, moved to the weighted mean of the common unknowns."""
    layout = Layout.of(models, [each.point for each in alone])
    common = layout.common
    total, right = np.zeros((len(common), len(common))), np.zeros(len(common))
    for each in alone:
        known = np.isin(common, each.model.free)
        information = np.linalg.inv(each.covariance[np.ix_(common[known], common[known])])
        total[np.ix_(known, known)] += information
        right[known] += information @ each.state.shared[common[known]]
    total[np.diag_indices(len(common))] += 1e-9
    mean, points = np.linalg.solve(total, right), []
    for each in alone:
        shared = np.zeros(SHARED + 3 * len(each.point.places))
        shared[common] = mean - each.state.shared[common]
        shared[rows_of(own_groups(each.model))] = 0.0
        free = each.model.free
        _, solution = solve_at(each.model, each.point)
        local = -solution.follow[:, :, : len(free)] @ shared[free]
        point = replace(each.point, state=each.state.moved(local, shared), is_robust=False)
        points.append(point if each.model.travels else _without_street(point))
    widest = {name: max(point.groups[name] for point in points) for name in AT}
    return with_factors(models, points, widest)


def _without_street(point: Point) -> Point:
    """Return the point of a turn on the spot without a local disturbance at the nodes."""
    local = point.state.local.copy()
    if point.course.nodes.tied_to is None:
        local[:, STREET] = 0.0
    rest = np.zeros(len(local))
    state = replace(point.state, local=local)
    return replace(point, state=state, places=replace(point.places, rest=rest))
