"""Sizes of noises and effects, estimated with the unknowns under log-normal priors."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.smoother.factors import motor_inputs
from magcal_ros.core.smoother.model import Model, Point
from magcal_ros.core.smoother.solver import Solution, StackedResiduals, WeightedResiduals
from magcal_ros.core.smoother.unknowns import AT, MOST_SPREADS, UNKNOWNS, VELOCITY, Size

LARGEST_STEP = 0.7
"""Largest step of the logarithm of a noise size, or of the distortion's factor, in one round."""


class Predicted(NamedTuple):
    """The variances of all residuals at the point of a solution."""

    parts: list[tuple[WeightedResiduals, FloatArray]]
    """Residuals with the sum of the variances of their components, shape (k,)."""
    velocity: FloatArray  # variance of the nodes' velocities, both axes together. Shape (n,).

    @classmethod
    def of(cls, solution: Solution) -> Predicted:
        """Return the variances by the covariance of a solution."""
        spread = _Spread.of(solution)
        velocity = np.trace(spread.own[:, VELOCITY, VELOCITY], axis1=1, axis2=2)
        return cls(list(spread.of_predictions(solution.stacks)), velocity)

    @property
    def log_curvature(self) -> float:
        """Log determinant of the expected curvature of the cost, minus that of the steps' weights.

        At its mode a Student distribution is sharper than it is wide: Laplace's approximation of
        the evidence needs the expected curvature. Each residual determines `weight * variance`
        unknowns, whose information is scaled by the ratio of the two weights.
        """
        return sum(
            float(np.sum(part.weight * variance * np.log(part.expected_share)))
            for part, variance in self.parts
        )


def noise_sizes(
    model: Model, point: Point, solution: Solution, predicted: Predicted
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the next sizes of the noises, and the effective number of residuals of each.

    By MacKay's fixed point (Bayesian interpolation, Neural Computation 4, 1992): the squared
    normalised residuals add up to the number of residuals that the samples determine.
    """
    sizes, shown = {}, {}
    for part, variance in predicted.parts:
        spent = part.weight * variance
        square = part.weight * np.sum(part.linear.residual**2, axis=1)
        for name, rows in part.sized.items():
            counted = rows & np.isfinite(part.variance)
            total, taken = float(np.sum(square[counted])), float(np.sum(spent[counted]))
            number = int(counted.sum()) * part.linear.residual.shape[1]
            if name == "street" and len(point.places):
                more, less = _by_centres(point, solution)
                total, taken, number = total + more, taken + less, number + 3 * len(point.places)
            shown[name] = max(number - taken, 0.0)
            sizes[name] = _next_size(
                point.sizes[name], total, shown[name], model.priors.sizes[name]
            )
    return sizes, shown


def _by_centres(point: Point, solution: Solution) -> tuple[float, float]:
    """Return the centres' squared normalised values, and the part due to their covariance."""
    places, variance = point.places, point.sizes["street"] ** 2
    rows = slice(-3 * len(places), None)
    blocks = solution.covariance[rows, rows].reshape(len(places), 3, len(places), 3)
    spread = np.einsum("iaja->ij", blocks) / variance
    values = point.state.centres @ point.state.centres.T / variance
    by_values, by_spread = (np.sum(places.information * each) for each in (values, spread))
    return float(by_values), float(by_spread)


@dataclass(frozen=True, eq=False)
class _Spread:
    """Blocks of the covariance: of a node, with the next one, and with the shared unknowns."""

    own: FloatArray
    beside: FloatArray
    cross: FloatArray
    shared: FloatArray

    @classmethod
    def of(cls, solution: Solution) -> _Spread:
        """Return the blocks at the point of a solution."""
        own, beside = solution.chain.covariance()
        follow = solution.follow
        count = follow.shape[2]
        cross = -(follow.reshape(-1, count) @ solution.covariance).reshape(follow.shape)
        own -= cross @ np.swapaxes(follow, 1, 2)
        beside -= cross[:-1] @ np.swapaxes(follow[1:], 1, 2)
        return cls(own, beside, cross, solution.covariance)

    def of_predictions(
        self, stacks: list[StackedResiduals]
    ) -> Iterator[tuple[WeightedResiduals, FloatArray]]:
        """Return the residuals with the sum of the variances of their components, shape (k,)."""
        for stack in stacks:
            local, count, known = stack.local, len(stack.rows), stack.reached + 1
            span = local.stop - local.start
            by_node, by_next = stack.rows[:, :, :span], stack.rows[:, :, span : stack.reached]
            own, beside = self.own[:, local, local], self.beside[:, local, local]
            cross = self.cross[:, local]
            direct = stack.rows[:, :, known:]
            by_shared = by_node @ cross[:count] if direct.shape[2] else 0.0
            total = ((by_node @ own[:count]) * by_node).sum(axis=2)
            if stack.is_linking:
                total += ((2.0 * by_node @ beside + by_next @ own[1:]) * by_next).sum(axis=2)
                by_shared = by_shared + by_next @ cross[1:] if direct.shape[2] else 0.0
            if direct.shape[2]:
                alone = (direct.reshape(-1, direct.shape[2]) @ self.shared).reshape(direct.shape)
                total += ((alone + 2.0 * by_shared) * direct).sum(axis=2)
            for part, own_columns in stack.columns:
                yield part, total[:, own_columns].sum(axis=1)


def _next_size(size: float, total: float, shown: float, belief: Size) -> float:
    """Return the next size, where `total` is the sum of squared normalised residuals.

    Newton's method solves t exp(-2 x) - n - (x + x0 - m) / s^2 = 0 for the step x of the logarithm.
    """
    shown = max(shown, 1e-3)
    off, change = math.log(size / belief.usual), 0.0
    for _ in range(30):
        scaled = total * math.exp(-2.0 * change)
        slope = scaled - shown - (off + change) / belief.spread**2
        step = slope / (2.0 * scaled + belief.spread**-2.0)
        change += max(-0.5, min(0.5, step))
        if abs(step) < 1e-4:
            break
    least = belief.usual * math.exp(-MOST_SPREADS * belief.spread)
    return min(
        belief.most, max(least, size * math.exp(max(-LARGEST_STEP, min(LARGEST_STEP, change))))
    )


def expected_square(size: float, shown: float, belief: Size) -> float:
    """Return the root mean square of a size under its posterior.

    Its logarithm is about normal, with the information of the `shown` residuals and of the prior.
    """
    return size * math.exp(1.0 / (2.0 * shown + belief.spread**-2.0))


def effect_factors(
    model: Model, point: Point, solution: Solution, expected: frozenset[str] = frozenset()
) -> dict[str, float]:
    """Return the factors of the effects' sigmas: the most likely ones, or root mean squares.

    The factors are chosen one after the other, each given the new values of the others: of two
    effects that explain the same samples, one remains. The shared unknowns of the point are at
    their posterior mean, and `solution` has the covariance for the point's factors. `expected` are
    the groups whose root mean square is returned.
    """
    free, found = model.free, dict(point.groups)
    # Each unknown is divided by its usual sigma.
    scale, count = model.priors.scale[free], len(free)
    covariance = solution.covariance[:count, :count] / np.outer(scale, scale)
    off = (point.state.shared - model.priors.mean)[free] / scale
    by_samples = np.linalg.solve(covariance, off)
    for name, spread in model.priors.spread.items():
        rows = model.priors.rows_of_group[name]
        if spread == 0.0 or not len(rows):
            continue
        column, mean = covariance[:, rows], covariance[rows] @ by_samples
        x, log_prior = model.priors.factors_of(name, found)
        as_expected = name in expected or name == "axes"
        if name == "soft_iron" and not (as_expected or model.priors.has_exact_axes):
            # Soft iron multiplies the attitudes: the linearisation holds near the point only.
            is_near = np.abs(x - math.log(found[name])) < LARGEST_STEP
            log_prior = np.where(is_near, log_prior, -math.inf)
        factor = _factor(x, log_prior, column[rows], mean, found[name], is_expected=as_expected)
        if (more := factor**-2.0 - found[name] ** -2.0) != 0.0:
            # By the matrix inversion lemma.
            covariance -= column @ np.linalg.solve(
                np.eye(len(rows)) / more + column[rows], column.T
            )
        found[name] = factor
    return found


def _factor(
    x: FloatArray,
    log_prior: FloatArray,
    covariance: FloatArray,
    mean: FloatArray,
    before: float,
    *,
    is_expected: bool,
) -> float:
    """Return the factor of a group's sigmas: the most likely one, or its root mean square.

    `covariance` and `mean` are the posterior of a group with the factor `before`. Without its
    prior it is the likelihood with all other unknowns marginalised. The marginal likelihood of any
    factor follows in closed form. `x` are the tried logarithms of the factor, and `log_prior` their
    log prior density.
    """
    spread, vectors = np.linalg.eigh(covariance)
    values = np.maximum(1.0 / spread - before**-2.0, 0.0)
    drawn = (vectors.T @ mean) / spread
    square = np.exp(2.0 * x)[:, None]
    more = square * values
    likely = 0.5 * (square * drawn**2 / (1.0 + more) - np.log1p(more)).sum(axis=1) + log_prior
    if not is_expected:
        return float(np.exp(x[np.argmax(likely)]))
    odds = np.exp(likely - likely.max())
    return math.sqrt(float(odds @ square[:, 0] / np.sum(odds)))


def whole_field_factors(point: Point) -> dict[str, float]:
    """Return factors of the motors' priors with which each input may explain the whole field."""
    shared, course = point.state.shared, point.course
    runs = course.moving > 0.0
    usual = {
        name: math.sqrt(float(np.sum(values[runs] ** 2)) / max(int(runs.sum()), 1))
        for name, values in motor_inputs(course, shared).items()
    }
    usual["motors_moving"] = 1.0
    usual["motors_rate"] += 1e-3
    size = sum(float(np.linalg.norm(shared[AT[name]])) * by for name, by in usual.items())
    sigma = {name: UNKNOWNS[name].sigma[0] for name in usual}
    if course.nodes.currents is not None:
        sigma["motors_current"] /= course.nodes.currents.battery.largest
        usual["motors_current"] += 1e-3
    return {
        name: max(point.groups[name], size / (math.sqrt(3.0) * by * sigma[name]))
        for name, by in usual.items()
    }
