"""Several turns of one robot: each is a block of nodes of its own, and they share the calibration.

Each window keeps its model, its sizes of noises and its kind of motion, as its own fit left them.
Nothing links the nodes of two windows. What belongs to the robot and to the place is one unknown
for all windows; what belongs to a moment is an unknown of each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.smoother.evidence import cost_of_nodes, cost_of_shared
from magcal_ros.core.smoother.fit import (
    Fit,
    SizeSteps,
    Tolerances,
    moved_by,
    share_of,
    stepped,
    widened,
    with_places,
)
from magcal_ros.core.smoother.model import (
    Model,
    Point,
    counted_unknowns,
    prior_at,
    solve_at,
    weigh,
)
from magcal_ros.core.smoother.shared_unknowns import (
    Layout,
    common_groups,
    is_own,
    own_groups,
    rows_of,
)
from magcal_ros.core.smoother.sizes import effect_factors, noise_sizes
from magcal_ros.core.smoother.solver import (
    Solution,
    Weighted,
    inverse_and_log_determinant,
    solve,
)
from magcal_ros.core.smoother.unknowns import AT, NOTHING, SHARED, STREET, TURNED, UNKNOWNS


@dataclass(frozen=True, eq=False)
class Together:
    """The optimum of several windows."""

    fits: list[Fit]
    """Of each window, with the information of all; its evidence is that of all."""
    informations: list[FloatArray]
    """Information of each window on the common unknowns. Shape (SHARED, SHARED)."""
    prior: FloatArray
    """What is known of these beforehand. Shape (SHARED, SHARED)."""
    evidence: float
    """Minus twice the logarithm of the evidence, but for a constant of the windows."""


@dataclass(frozen=True, eq=False)
class _Step:
    """A Gauss-Newton step of all windows."""

    weighted: list[dict[str, Weighted]]
    solutions: list[Solution]
    """Of each window, with the information of all on the shared unknowns."""
    layout: Layout
    prior: FloatArray
    """Information on all shared unknowns before the samples. Shape (s, s)."""
    log_determinant: float

    @classmethod
    def at(
        cls, models: Sequence[Model], points: Sequence[Point], *, is_expected: bool = False
    ) -> _Step:
        """Take a step, or find the covariance (`solve_at`).

        Raises `numpy.linalg.LinAlgError` if a matrix is not positive definite.
        """
        layout = Layout.of(models, points)
        prior, gradient = np.zeros((layout.count, layout.count)), np.zeros(layout.count)
        total = np.zeros_like(prior)
        weighted, alone = [], []
        known = np.zeros(layout.count, dtype=bool)
        for model, point, row in zip(models, points, layout.rows, strict=True):
            parts, solution = solve_at(model, point, is_expected=is_expected)
            before = prior_at(model, point)
            by_prior = before.information @ before.offset
            # The prior of what windows have in common counts once.
            new = ~known[row]
            prior[np.ix_(row[new], row[new])] = before.information[np.ix_(new, new)]
            gradient[row[new]] += by_prior[new]
            known[row] = True
            total[np.ix_(row, row)] += solution.information - before.information
            gradient[row] += solution.gradient - by_prior
            weighted.append(parts)
            alone.append(solution)
        total += prior
        size = 1.0 / np.sqrt(np.maximum(np.diag(total), 1e-12))
        inverse, determinant = inverse_and_log_determinant(total * np.outer(size, size))
        covariance = inverse * np.outer(size, size)
        step = covariance @ gradient
        solutions = [
            solution.given(step[row], covariance[np.ix_(row, row)])
            for solution, row in zip(alone, layout.rows, strict=True)
        ]
        determinant += sum(each.chain.log_determinant for each in alone) - 2.0 * float(
            np.sum(np.log(size))
        )
        return cls(weighted, solutions, layout, prior, determinant)

    @property
    def prior_of_common(self) -> FloatArray:
        """Prior information on the common unknowns, (SHARED, SHARED)."""
        common, out = self.layout.common, np.zeros((SHARED, SHARED))
        out[np.ix_(common, common)] = self.prior[: len(common), : len(common)]
        return out


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
    """Return the expected information of the same turn on another tilt, (SHARED, SHARED).

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


def fit_together(
    alone: Sequence[Fit], yaw_sigma: float, tolerances: Tolerances = Tolerances()
) -> Together:
    """Return the joint fit of windows that share the calibration, from the fits of each.

    `yaw_sigma` is the prior of the installation's yaw, radians, which several tilts show. Raises
    `numpy.linalg.LinAlgError` if a matrix is not positive definite.
    """
    models = _with_one_prior([each.model for each in alone], yaw_sigma)
    points = _from_one_start(models, alone)
    every = range(len(models))
    steps, before = [SizeSteps() for _ in models], math.inf
    fewest = max(tolerances.places_at) if any(m.travels for m in models) else tolerances.fewest
    for rounds in range(tolerances.rounds + 1):
        if rounds in tolerances.places_at:
            points = [
                with_places(models[k], points[k]) if models[k].travels else points[k] for k in every
            ]
        found = _Step.at(models, points)
        evidence = _evidence(models, points, found)
        share = min(share_of(each, tolerances) for each in found.solutions)
        moved = max(moved_by(models[k], found.solutions[k]) for k in every)
        converged = rounds > fewest and share == 1.0 and moved < tolerances.step
        converged = converged and abs(evidence - before) < tolerances.evidence
        if converged or rounds == tolerances.rounds:
            break
        before = evidence
        for k in every:
            model, solution, parts = models[k], found.solutions[k], found.weighted[k]
            steps[k], point = steps[k].next(model, points[k], parts, solution, rounds > 0)
            stands = stepped(model, point, solution, share)
            points[k] = replace(stands, is_robust=rounds >= tolerances.gaussian)
        if rounds >= tolerances.held:
            points = _agreed(
                models,
                [
                    replace(p, groups=effect_factors(m, p, s))
                    for m, p, s in zip(models, points, found.solutions, strict=True)
                ],
            )
    wide = _agreed(models, [_widened(models[k], points[k], found, k) for k in every])
    doubted = _Step.at(models, wide, is_expected=True)
    fits, informations = [], []
    for k, solution in enumerate(doubted.solutions):
        free, covariance = models[k].free, np.zeros((SHARED, SHARED))
        covariance[np.ix_(free, free)] = solution.covariance[: len(free), : len(free)]
        kind, parts, end = alone[k].kind, found.weighted[k], (rounds, converged, moved)
        fits.append(Fit(kind, models[k], points[k], covariance, evidence, parts, *end))
        informations.append(information_of(models[k], wide[k], solution))
    return Together(fits, informations, doubted.prior_of_common, evidence)


def _evidence(models: list[Model], points: list[Point], found: _Step) -> float:
    """Return minus twice the log evidence of all windows, up to a constant."""
    common, out = common_groups(models), found.log_determinant
    for k, (model, point) in enumerate(zip(models, points, strict=True)):
        names = [name for name in AT if common.get(name, k) == k]
        out += cost_of_nodes(model, point, found.weighted[k])
        out += cost_of_shared(model, point, names)
    return out


def _widened(model: Model, point: Point, found: _Step, which: int) -> Point:
    """Return a window's point with the sizes' posterior mean squares."""
    weighted, solution = found.weighted[which], found.solutions[which]
    _, shown, _ = noise_sizes(model, point, weighted, solution)
    return widened(model, point, solution, shown)


def _with_one_prior(models: Sequence[Model], yaw_sigma: float) -> list[Model]:
    """Return models with common priors of the shared unknowns: the widest of each."""
    scale = np.stack([model.priors.scale for model in models]).max(axis=0)
    scale[TURNED] = yaw_sigma
    first, out = models[0].priors, []
    for model in models:
        own = rows_of(own_groups(model))
        its_scale, its_mean = scale.copy(), first.mean.copy()
        its_scale[own], its_mean[own] = model.priors.scale[own], model.priors.mean[own]
        if model.priors.sizes["street"].usual > NOTHING:
            its_scale[AT["place"]] = UNKNOWNS["place"].sigma
        priors = replace(model.priors, scale=its_scale, mean=its_mean, earth=first.earth)
        out.append(replace(model, priors=priors))
    return out


def _from_one_start(models: Sequence[Model], alone: Sequence[Fit]) -> list[Point]:
    """Return each window's optimum, moved to the common mean of the shared unknowns."""
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
    return _with_factors(models, points, widest)


def _without_street(point: Point) -> Point:
    """Return the point of a turn on the spot without a local disturbance at the nodes."""
    local = point.state.local.copy()
    if point.course.nodes.tied_to is None:
        local[:, STREET] = 0.0
    rest = np.zeros(len(local))
    state = replace(point.state, local=local)
    return replace(point, state=state, places=replace(point.places, rest=rest))


def _agreed(models: Sequence[Model], points: Sequence[Point]) -> list[Point]:
    """Return points with the same factors of the shared groups."""
    factors = {name: points[k].groups[name] for name, k in common_groups(models).items()}
    return _with_factors(models, points, factors)


def _with_factors(
    models: Sequence[Model], points: Sequence[Point], factors: dict[str, float]
) -> list[Point]:
    """Return points with these factors of the common groups."""
    out = []
    for model, point in zip(models, points, strict=True):
        shared = {name: f for name, f in factors.items() if name not in own_groups(model)}
        out.append(replace(point, groups={**point.groups, **shared}))
    return out
