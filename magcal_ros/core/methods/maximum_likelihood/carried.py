"""The fit in which the gyro carries the attitude from sample to sample.

Instead of an attitude for each sample there is one attitude for the turn, and the gyro's errors:
bias, scale and a slow drift whose size is estimated. This ties neighbours together: a wobble
needs no price, short arcs gain most, and a field that does not turn with the robot shows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.methods.maximum_likelihood import parameters as p
from magcal_ros.core.methods.maximum_likelihood.choice import (
    SOFT_IRON_PRICE,
    Gain,
    is_steady,
    keeps_samples,
)
from magcal_ros.core.methods.maximum_likelihood.correlation import samples_per_independent
from magcal_ros.core.methods.maximum_likelihood.gyro import Carrier
from magcal_ros.core.methods.maximum_likelihood.linearise import (
    ChiSquares,
    Noise,
    Problem,
    Weights,
    chi_squares,
)
from magcal_ros.core.methods.maximum_likelihood.model import (
    Prediction,
    State,
    global_jacobian,
    local_jacobian,
    predict,
)
from magcal_ros.core.methods.maximum_likelihood.prior import Prior
from magcal_ros.core.methods.maximum_likelihood.refine import Solution
from magcal_ros.core.methods.maximum_likelihood.sigmas import (
    FIELD_FLOOR,
    UP_FLOOR,
    largest_change,
)
from magcal_ros.core.methods.maximum_likelihood.weights import (
    gate_residuals,
    hard_weights,
    student_weights,
)
from magcal_ros.core.rotations import exp_rotations

SUSPICIOUS_BIAS = 4.0
SUSPICIOUS_STRAY = 3.5
"""A gyro bias, or a mean of up's residual, beyond so many sigmas calls for a look at the
accelerometer."""
OFFSET_PRICE = 30.0
"""By how much, times kappa, the cost must fall for an offset of the accelerometer."""
FIRST_DRIFT = 2e-3
USUAL_DRIFT = 5e-4
HONEST_DRIFT = 1e-3
HONEST_SHARE = 0.95
SMALLEST_DRIFT = 2e-4
LARGEST_DRIFT = 0.05
"""Radians per root second."""
SOFT_ROUNDS = 5
WORST_FIELD_RATIO = 2.0
LENIENCE = 0.02
LEAST_BELIEVED = 0.6


@dataclass(frozen=True, eq=False)
class Carried:
    """A solution whose attitudes the gyro carried.

    Parameters
    ----------
    solution : Solution
        Its attitudes are the carried ones.
    information : ndarray, shape (g, g)
        On the free globals, the gyro's errors eliminated, prior times kappa included.
    cost : float
        Weighted sum of squares, priors included.
    chi_square : ndarray, shape (n,)
        The counted samples' share of it.
    drift : float
        Random walk of the gyro's attitude, radians per root second.
    coefficients : ndarray, shape (c,)
        The gyro's errors.
    carrier : Carrier
        What they are coefficients of.
    """

    solution: Solution
    information: FloatArray
    cost: float
    chi_square: FloatArray
    drift: float
    coefficients: FloatArray
    carrier: Carrier

    @property
    def offset(self) -> FloatArray:
        """What the up vectors read too much all the time, in body axes, shape (3,)."""
        return self.carrier.offset(self.coefficients)


@dataclass(frozen=True, eq=False)
class _Place:
    """Where the iteration stands."""

    state: State
    prediction: Prediction
    coefficients: FloatArray


@dataclass(frozen=True, eq=False)
class _Equations:
    """Normal equations over free globals and gyro coefficients, priors included."""

    residual: FloatArray
    information: FloatArray
    gradient: FloatArray
    spent: float


def without_axes(prior: Prior) -> Prior:
    """Return the prior that leaves both axes alone: here they only name a frame."""
    return replace(prior, free=prior.free[prior.free >= p.ROLL])


def fit_carried(start: Solution, carrier: Carrier, prior: Prior, rounds: int = 20) -> Carried:
    """Fit with the attitudes carried by the gyro.

    Parameters
    ----------
    start : Solution
        Any solution on the samples that `carrier` belongs to.
    carrier : Carrier
    prior : Prior
    rounds : int
        At most so many rounds of step, weights and noise.
    """
    problem = replace(start.problem, prior=without_axes(prior), rigid=False, kappa=1.0)
    problem = problem.with_noise(Noise(0.03, 0.03, 0.1))
    place, drift = _begin(start, carrier), FIRST_DRIFT
    for turn in range(rounds):
        chi = chi_squares(place.state, place.prediction, problem.noise)
        soft = turn < SOFT_ROUNDS
        weights = _weights(place, problem, chi, soft=soft)
        problem = problem.with_weights(weights)
        equations = _equations(place, problem, carrier, drift)
        if not soft:
            kappa = samples_per_independent(equations.residual, weights.sample)
            problem = replace(problem, kappa=kappa)
        noise = _noise(equations, problem)
        new_drift = _drift(place, equations, problem, carrier, drift)
        place, size = _step(place, equations, problem, carrier, drift)
        change = largest_change(noise, problem.noise) + abs(math.log(new_drift / drift)) / 10.0
        problem, drift = problem.with_noise(noise), new_drift
        if turn > SOFT_ROUNDS + 2 and change < 0.015 and size < 1e-4:
            break
    return converge_carried(place, problem, carrier, drift)


def converge_carried(
    place: _Place, problem: Problem, carrier: Carrier, drift: float, steps: int = 10
) -> Carried:
    """Hold gate, noise and drift, and step until nothing moves."""
    for _ in range(steps):
        equations = _equations(place, problem, carrier, drift)
        place, size = _step(place, equations, problem, carrier, drift)
        if size < 1e-11:
            break
    equations = _equations(place, problem, carrier, drift)
    free = len(problem.prior.free)
    block = equations.information
    # Without a believed sample the gyro's own errors are not determined either.
    shared = np.linalg.lstsq(block[free:, free:], block[free:, :free], rcond=1e-14)[0]
    information = block[:free, :free] - block[:free, free:] @ shared
    lean = np.sqrt(np.mean(place.state.lean[:, :2] ** 2))
    noise = replace(problem.noise, wobble=max(float(lean), 1e-3))
    solution = Solution(place.state, problem.with_noise(noise))
    return Carried(
        solution,
        information,
        _cost(place, problem, carrier, drift),
        chi_squares(place.state, place.prediction, problem.noise).data * problem.weights.sample,
        drift,
        place.coefficients,
        carrier,
    )


@dataclass(frozen=True, eq=False)
class CarriedChoice:
    """The model that the samples ask for, and by how much chi-square fell by soft iron."""

    best: Carried
    soft_iron_gain: float


def choose_carried(
    start: Solution, carrier: Carrier, with_iron: Prior, *, always_iron: bool
) -> CarriedChoice:
    """Fit with soft iron and without, and take what is asked for."""
    plain = _with_or_without_offset(start, carrier)
    carrier = plain.carrier
    if not with_iron.has_soft_iron:
        return CarriedChoice(plain, 0.0)
    # Where soft iron was taken for drift or outliers, the plain fit no longer shows its slope.
    honest = plain.drift < HONEST_DRIFT and plain.solution.believed.mean() > HONEST_SHARE
    little = honest and _expected_gain(plain, with_iron) < 0.5 * SOFT_IRON_PRICE
    if little and not always_iron:
        return CarriedChoice(plain, 0.0)
    iron = fit_carried(start, carrier, with_iron)
    without = _held_to(iron, carrier, start.problem.prior)
    gain = Gain(without.cost - iron.cost, is_steady(without.chi_square - iron.chi_square))
    asked = keeps_samples(plain.solution, iron.solution)
    # A gyro that drifts more than gyros do hides errors that last, which kappa does not see.
    kappa = iron.solution.problem.kappa * max(1.0, iron.drift / USUAL_DRIFT)
    asked = asked and gain.asks_for_it(kappa)
    return CarriedChoice(iron if always_iron or asked else plain, gain.total)


def _expected_gain(plain: Carried, with_iron: Prior) -> float:
    """Return by how much the cost would fall with soft iron, from its slope at zero."""
    problem = replace(plain.solution.problem, prior=without_axes(with_iron))
    place = _at(plain.solution.state, plain.coefficients, problem, plain.carrier)
    equations = _equations(place, problem, plain.carrier, plain.drift)
    move = np.linalg.lstsq(equations.information, equations.gradient, rcond=1e-14)[0]
    return float(equations.gradient @ move)


def _with_or_without_offset(start: Solution, carrier: Carrier) -> Carried:
    """Fit without soft iron, and with an offset of the accelerometer where the gyro asks for it.

    Held to an accelerometer that is pulled sideways all the time, the gyro can only follow with
    a bias that no gyro has.
    """
    plain = fit_carried(start, carrier, start.problem.prior)
    if not _strained(plain):
        return plain
    offset = fit_carried(start, replace(carrier, sideways=True), start.problem.prior)
    held = _held_to(offset, carrier, start.problem.prior)
    if held.cost - offset.cost > OFFSET_PRICE * offset.solution.problem.kappa:
        return offset
    return plain


def _strained(plain: Carried) -> bool:
    """Return whether the gyro needs a large bias, or up strays to one side all the time."""
    problem = plain.solution.problem
    counted = problem.weights.sample
    stray = predict(plain.solution.state, problem.samples).up_residual
    count = max(float(counted.sum()), 1.0)
    mean = float(np.linalg.norm(counted @ stray)) / count
    chance = problem.noise.up * math.sqrt(problem.kappa / count)
    bias = plain.carrier.bias_pull(plain.coefficients)
    return bias > SUSPICIOUS_BIAS or mean > SUSPICIOUS_STRAY * chance


def explains_as_well(carried: Carried, free: Solution) -> bool:
    """Return whether the gyro's attitudes fit about as well as attitudes of the samples' own."""
    solution = carried.solution
    usual = max(free.problem.noise.field, FIELD_FLOOR)
    return bool(
        solution.problem.noise.field < WORST_FIELD_RATIO * usual + LENIENCE
        and solution.believed.mean() > LEAST_BELIEVED
        and carried.drift < 0.9 * LARGEST_DRIFT
    )


def _held_to(rich: Carried, carrier: Carrier, prior: Prior) -> Carried:
    """Return a poorer model under the noise, gate and drift of a richer one."""
    solution = rich.solution
    problem = replace(solution.problem, prior=without_axes(prior))
    shared = solution.state.shared
    if not prior.has_soft_iron:
        shared = shared.without_soft_iron()
    place = _begin(Solution(State(shared, solution.state.attitude), problem), carrier)
    return converge_carried(place, problem, carrier, rich.drift)


def _begin(start: Solution, carrier: Carrier) -> _Place:
    """Turn the gyro's attitudes so that they fit the start's on the whole."""
    shared = start.state.shared
    body = shared.body_axis @ start.state.attitude @ shared.world_axis.T
    counted = start.problem.weights.sample[:, None, None]
    total = np.sum(np.swapaxes(carrier.relative, 1, 2) @ (body * counted), axis=0)
    left, _, right = np.linalg.svd(total)
    first = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    attitude = shared.body_axis.T @ carrier.relative @ first @ shared.world_axis
    state = State(shared, attitude)
    # The coefficients speak in the first sample's axes, the attitudes in the turn's frame.
    return _at(state, np.zeros(carrier.size), start.problem, carrier)


def _at(state: State, coefficients: FloatArray, problem: Problem, carrier: Carrier) -> _Place:
    samples = problem.samples
    if carrier.sideways:
        samples = replace(samples, up=samples.up - carrier.offset(coefficients))
    return _Place(state, predict(state, samples), coefficients)


def _weights(place: _Place, problem: Problem, chi: ChiSquares, *, soft: bool) -> Weights:
    if soft:
        return student_weights(chi, rigid=True)
    noise = problem.noise
    residual = np.concatenate(
        [place.prediction.up_residual / noise.up, place.prediction.field_residual / noise.field],
        axis=1,
    )
    return hard_weights(gate_residuals(residual, chi, np.zeros(len(residual))))


def _frame(place: _Place, carrier: Carrier) -> FloatArray:
    """Return the derivative of each sample's local step by the coefficients, shape (n, 3, c)."""
    to_frame = place.state.shared.body_axis.T @ carrier.relative
    return np.asarray(to_frame @ carrier.basis)


def _equations(place: _Place, problem: Problem, carrier: Carrier, drift: float) -> _Equations:
    prediction, noise, free = place.prediction, problem.noise, problem.prior.free
    whitening = np.repeat([1.0 / noise.up, 1.0 / noise.field], 3)
    local = local_jacobian(prediction)
    jacobian = global_jacobian(place.state, prediction, local, problem.samples)[:, :, free]
    columns = [jacobian, local @ _frame(place, carrier)]
    if carrier.sideways:
        by_offset = np.zeros_like(local)
        by_offset[:, :3] = place.state.shared.body_axis.T
        columns.append(by_offset)
    jacobian = np.concatenate(columns, axis=2)
    jacobian *= whitening[:, None]
    residual = np.concatenate([prediction.up_residual, prediction.field_residual], axis=1)
    residual *= whitening
    weight = (problem.weights.data * problem.weights.sample)[:, None, None]
    size = jacobian.shape[2]
    rows = (jacobian * weight).reshape(-1, size).T
    data = rows @ jacobian.reshape(-1, size)
    gradient = rows @ residual.ravel()
    prior = np.zeros((size, size))
    count = len(free)
    believed = problem.prior.information
    prior[:count, :count] = np.diag(believed[free])
    prior[count:, count:] = carrier.prior_information(drift)
    prior *= problem.kappa
    deviation = problem.prior.deviation(place.state.shared)
    gradient[:count] += problem.kappa * (believed * deviation)[free]
    gradient[count:] -= prior[count:, count:] @ place.coefficients
    spent = size - float(np.trace(np.linalg.solve(data + prior + 1e-9 * np.eye(size), prior)))
    return _Equations(residual, data + prior, gradient, spent)


def _step(
    place: _Place, equations: _Equations, problem: Problem, carrier: Carrier, drift: float
) -> tuple[_Place, float]:
    """Take a damped step that lowers the cost; return where it led and how far."""
    before = _cost(place, problem, carrier, drift)
    free = problem.prior.free
    diagonal = np.diag(np.diag(equations.information) + 1e-9)
    frame = _frame(place, carrier)
    for damping in (0.0, 1e-4, 1e-2, 1.0, 100.0):
        damped = equations.information + damping * diagonal
        move = np.linalg.lstsq(damped, equations.gradient, rcond=1e-14)[0]
        full = np.zeros(p.COUNT)
        full[free] = move[: len(free)]
        errors = move[len(free) :]
        turns = exp_rotations(frame @ errors[: frame.shape[2]])
        state = State(place.state.shared.moved(full), turns @ place.state.attitude)
        moved = _at(state, place.coefficients + errors, problem, carrier)
        if _cost(moved, problem, carrier, drift) <= before * (1.0 + 1e-12) + 1e-9:
            return moved, float(np.abs(move[: len(free)]).max())
    return place, 0.0


def _cost(place: _Place, problem: Problem, carrier: Carrier, drift: float) -> float:
    chi = chi_squares(place.state, place.prediction, problem.noise)
    weights = problem.weights
    errors = place.coefficients @ carrier.prior_information(drift) @ place.coefficients
    beliefs = problem.prior.cost(place.state.shared) + float(errors)
    return float((weights.sample * weights.data) @ chi.data) + problem.kappa * beliefs


def _noise(equations: _Equations, problem: Problem) -> Noise:
    weights, noise = problem.weights, problem.noise
    squares = (weights.data * weights.sample)[:, None] * equations.residual**2
    # Where no sample is believed the noise shrinks no further than below, and the fit is refused.
    count = max(float(weights.sample.sum()), 1.0)
    left = max(1.0 - equations.spent / (5.0 * count), 0.1)
    up = noise.up * math.sqrt(float(squares[:, :3].sum()) / (2.0 * count * left))
    field = noise.field * math.sqrt(float(squares[:, 3:].sum()) / (3.0 * count * left))
    return Noise(
        max(min(up, 2.0 * noise.up), 0.5 * noise.up, UP_FLOOR),
        max(min(field, 2.0 * noise.field), 0.5 * noise.field, FIELD_FLOOR),
        noise.wobble,
    )


def _drift(
    place: _Place, equations: _Equations, problem: Problem, carrier: Carrier, drift: float
) -> float:
    """Return the random walk that the knots ask for (the fixed point of their evidence)."""
    if carrier.knots == 0:
        return drift
    size = 3 * carrier.knots
    first = len(problem.prior.free) + 9
    rows = slice(first, first + size)
    covariance = np.linalg.pinv(equations.information, hermitian=True)[rows, rows]
    walk = carrier.prior_information(drift)[9 : 9 + size, 9 : 9 + size]
    seen = size - problem.kappa * float(np.sum(covariance * walk))
    moved = float(np.sum(carrier.knot_steps(place.coefficients) ** 2)) / carrier.spacing
    new = math.sqrt(moved / max(seen, 0.5))
    return min(max(new, SMALLEST_DRIFT, 0.5 * drift), LARGEST_DRIFT, 2.0 * drift)
