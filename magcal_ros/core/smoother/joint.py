"""A Gauss-Newton step of one window, or of several that share unknowns.

Each window keeps its model, noise sizes and kind of motion. Nothing links the nodes of two windows.
Properties of the robot and of the place are common unknowns of all windows; what changes with time
is a separate unknown of each window.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray
from magcal_ros.core.smoother.model import (
    CHANGES,
    Model,
    Point,
    counted_unknowns,
    prior_at,
    solve_at,
)
from magcal_ros.core.smoother.sizes import Predicted
from magcal_ros.core.smoother.solver import Solution, WeightedResiduals, inverse_and_log_determinant
from magcal_ros.core.smoother.unknowns import (
    ACCELERATION,
    AT,
    BODY_FIELD,
    EARTH,
    SHARED,
    STREET,
    VELOCITY,
)

_ROWS = {name: np.arange(at.start, at.stop) for name, at in AT.items()}
OF_A_MOMENT = ("gyro_bias", "bias_walk", "drift", "gradient", "place")
"""Groups of shared unknowns that are separate for each window."""
OF_A_TURN = ("gyro_matrix", "lever_arm", "sway_arm", "axis", "upright")
"""Further such groups if axes of the gyro are dead: the turn's axis and circle."""


@dataclass(frozen=True, eq=False)
class Layout:
    """The indices of each window's unknowns among those of all."""

    rows: list[IntArray]  # for each window, the indices of its free shared unknowns and its centres
    common: IntArray  # which shared unknowns the first rows are
    count: int

    @classmethod
    def of(cls, models: Sequence[Model], points: Sequence[Point]) -> Layout:
        """Return the layout: common unknowns first, then those of each window."""
        counted = [counted_unknowns(m, p.places) for m, p in zip(models, points, strict=True)]
        owned = [is_own(model, free) for model, free in zip(models, counted, strict=True)]
        common = np.unique(
            np.concatenate([free[~own] for free, own in zip(counted, owned, strict=True)])
        )
        at, rows = len(common), []
        for free, own in zip(counted, owned, strict=True):
            row = np.searchsorted(common, np.where(own, common[0], free))
            row[own] = np.arange(at, at + int(own.sum()))
            at += int(own.sum())
            rows.append(row)
        return cls(rows, common, at)


def own_groups(model: Model) -> tuple[str, ...]:
    """Return the groups of shared unknowns that belong to one window."""
    return OF_A_MOMENT + (OF_A_TURN if "lean" in model.priors.sizes else ())


def common_groups(models: Sequence[Model]) -> dict[str, int]:
    """Return the common groups, each with the window that has most of its unknowns free."""
    own = [own_groups(model) for model in models]
    found = {}
    for name in AT:
        number = [
            -1 if name in groups else len(model.priors.rows_of_group[name])
            for groups, model in zip(own, models, strict=True)
        ]
        if max(number) >= 0:
            found[name] = number.index(max(number))
    return found


def is_own(model: Model, counted: IntArray) -> BoolArray:
    """Return which unknowns belong to one window; its centres do."""
    return np.isin(counted, rows_of(own_groups(model))) | (counted >= SHARED)


def rows_of(groups: Sequence[str]) -> IntArray:
    """Return the indices of the shared unknowns of some groups."""
    return np.concatenate([_ROWS[name] for name in groups])


def agreed(models: Sequence[Model], points: Sequence[Point]) -> list[Point]:
    """Return points with the same factors of the common groups."""
    if len(models) == 1:
        return list(points)
    factors = {name: points[k].groups[name] for name, k in common_groups(models).items()}
    return with_factors(models, points, factors)


def with_factors(
    models: Sequence[Model], points: Sequence[Point], factors: dict[str, float]
) -> list[Point]:
    """Return points with these factors of the common groups."""
    out = []
    for model, point in zip(models, points, strict=True):
        shared = {name: f for name, f in factors.items() if name not in own_groups(model)}
        out.append(replace(point, groups={**point.groups, **shared}))
    return out


@dataclass(frozen=True, eq=False)
class Joint:
    """A Gauss-Newton step of all windows, or their covariance."""

    weighted: list[dict[str, WeightedResiduals]]
    solutions: list[Solution]  # of each window, with the information of all on the shared unknowns
    log_determinant: float

    @classmethod
    def at(
        cls, models: Sequence[Model], points: Sequence[Point], *, is_expected: bool = False
    ) -> Joint:
        """Take a step, or find the covariance (`solve_at`).

        Raises `numpy.linalg.LinAlgError` if a matrix is not positive definite.
        """
        solved = [
            solve_at(model, point, is_expected=is_expected)
            for model, point in zip(models, points, strict=True)
        ]
        weighted, alone = [parts for parts, _ in solved], [solution for _, solution in solved]
        if len(alone) == 1:
            return cls(weighted, alone, alone[0].log_determinant)
        layout = Layout.of(models, points)
        total, gradient = np.zeros((layout.count, layout.count)), np.zeros(layout.count)
        known = np.zeros(layout.count, dtype=bool)
        for model, point, solution, row in zip(models, points, alone, layout.rows, strict=True):
            before = prior_at(model, point)
            by_prior = before.information @ before.offset
            # The prior of the common unknowns counts once.
            new = ~known[row]
            total[np.ix_(row[new], row[new])] += before.information[np.ix_(new, new)]
            gradient[row[new]] += by_prior[new]
            known[row] = True
            total[np.ix_(row, row)] += solution.information - before.information
            gradient[row] += solution.gradient - by_prior
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
        return cls(weighted, solutions, determinant)

    @cached_property
    def predicted(self) -> list[Predicted]:
        """The variances of the residuals of each window."""
        return [Predicted.of(each) for each in self.solutions]

    @property
    def log_curvature(self) -> float:
        """The sum of the windows' `Predicted.log_curvature`."""
        return sum(each.log_curvature for each in self.predicted)

    def cost(self, models: Sequence[Model], points: Sequence[Point]) -> float:
        """Return what the iterations minimise, up to a constant of the windows.

        With `log_curvature` it is minus twice the logarithm of the evidence by Laplace's
        approximation, at the most likely sizes.
        """
        common, out = common_groups(models), self.log_determinant
        for k, (model, point) in enumerate(zip(models, points, strict=True)):
            names = [name for name in AT if common.get(name, k) == k]
            out += _cost_of_nodes(model, point, self.weighted[k])
            out += _cost_of_shared(model, point, names)
        return out


def prior_of_common(models: Sequence[Model], points: Sequence[Point]) -> FloatArray:
    """Return the prior information on the common unknowns, (SHARED, SHARED)."""
    out = np.zeros((SHARED, SHARED))
    for model, point in zip(models, points, strict=True):
        counted = counted_unknowns(model, point.places)
        common = ~is_own(model, counted)
        rows = np.ix_(counted[common], counted[common])
        out[rows] = prior_at(model, point).information[np.ix_(common, common)]
    return out


def _cost_of_nodes(model: Model, point: Point, weighted: dict[str, WeightedResiduals]) -> float:
    """Return minus twice the log of likelihood and priors, except those of shared unknowns."""
    state, sizes, places = point.state, point.sizes, point.places
    cost = sum(part.cost for part in weighted.values())
    levels = (
        (VELOCITY, model.kind.velocity),
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


def _cost_of_shared(model: Model, point: Point, names: Iterable[str]) -> float:
    """Return minus twice the log prior of some groups of shared unknowns."""
    names, scales = list(names), model.scales(point.groups)
    rows = rows_of([name for name in names if name != "earth"])
    rows = rows[scales[rows] > 0.0]
    off, scale = (point.state.shared - model.priors.mean)[rows], scales[rows]
    cost = float(np.sum((off / scale) ** 2 + 2.0 * np.log(scale)))
    if "earth" in names:
        cost += model.earth.cost(point.state.shared[EARTH])
    known: dict[str, float] = {}
    for name in names:
        if model.priors.spread[name] > 0.0:
            # The factor of non-orthogonal axes follows from that of the distortion.
            if name != "axes":
                x = np.log([point.groups[name]])
                cost -= 2.0 * float(model.priors.log_density(name, x, known)[0])
            known[name] = point.groups[name]
    return cost
