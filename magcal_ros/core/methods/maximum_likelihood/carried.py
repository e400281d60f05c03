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
from magcal_ros.core.methods.maximum_likelihood.carried_equations import (
    LARGEST_DRIFT,
    Place,
    Task,
    at,
    cost,
    drift_from,
    noise_from,
    normal_equations,
    step,
)
from magcal_ros.core.methods.maximum_likelihood.choice import (
    HONEST_SHARE,
    SOFT_IRON_PRICE,
    keeps_samples,
    lasting_gain,
)
from magcal_ros.core.methods.maximum_likelihood.correlation import samples_per_independent
from magcal_ros.core.methods.maximum_likelihood.doubt import (
    WORTH_A_FIT,
    Doubt,
    Look,
    look_for_soft_iron,
)
from magcal_ros.core.methods.maximum_likelihood.gyro import Carrier
from magcal_ros.core.methods.maximum_likelihood.linearise import (
    Problem,
    Weights,
    chi_squares,
)
from magcal_ros.core.methods.maximum_likelihood.model import State, predict
from magcal_ros.core.methods.maximum_likelihood.prior import Prior
from magcal_ros.core.methods.maximum_likelihood.refine import FIRST_NOISE, Solution
from magcal_ros.core.methods.maximum_likelihood.sigmas import (
    FIELD_FLOOR,
    largest_change,
)
from magcal_ros.core.methods.maximum_likelihood.weights import (
    gate_residuals,
    hard_weights,
    student_weights,
)

SUSPICIOUS_BIAS = 4.0
SUSPICIOUS_STRAY = 3.5
"""A gyro bias, or a mean of up's residual, beyond so many sigmas calls for a look at the
accelerometer."""
OFFSET_PRICE = 30.0
"""By how much, times kappa, the cost must fall for an offset of the accelerometer."""
FIRST_DRIFT = 2e-3
USUAL_DRIFT = 1e-3
"""Radians per root second; gyros drift less."""
SOFT_ROUNDS = 5
SETTLED = 3e-4
"""A step of the globals far below their errors; the last steps come when the gate is held."""
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
    task = Task(problem.with_noise(FIRST_NOISE), carrier, FIRST_DRIFT)
    place = begin(start, task)
    for turn in range(rounds):
        soft = turn < SOFT_ROUNDS
        weights = carried_weights(place, task.problem, soft=soft)
        moved = float(np.mean(weights.sample != task.problem.weights.sample))
        task = task.with_weights(weights)
        equations = normal_equations(place, task)
        if not soft:
            kappa = samples_per_independent(equations.residual, weights.sample)
            task = replace(task, problem=replace(task.problem, kappa=kappa))
        noise = noise_from(equations, task.problem)
        drift = drift_from(place, equations, task)
        place, size = step(place, equations, task)
        change = largest_change(noise, task.problem.noise) + abs(math.log(drift / task.drift)) / 10
        task = replace(task, problem=task.problem.with_noise(noise), drift=drift)
        if turn > SOFT_ROUNDS + 1 and change < 0.015 and size < SETTLED and moved < 0.002:
            break
    return converge_carried(place, task)


def converge_carried(place: Place, task: Task, steps: int = 10, tolerance: float = 1e-9) -> Carried:
    """Hold gate, noise and drift, and step until nothing moves."""
    for _ in range(steps):
        place, size = step(place, normal_equations(place, task), task)
        if size < tolerance:
            break
    problem = task.problem
    lean = np.sqrt(np.mean(place.state.lean[:, :2] ** 2))
    noise = replace(problem.noise, wobble=max(float(lean), 1e-3))
    return Carried(
        Solution(place.state, problem.with_noise(noise)),
        normal_equations(place, task).of_globals,
        cost(place, task),
        chi_squares(place.state, place.prediction, noise).data * problem.weights.sample,
        task.drift,
        place.coefficients,
        task.carrier,
    )


@dataclass(frozen=True, eq=False)
class CarriedChoice:
    """The model that the samples ask for, by how much chi-square fell by soft iron, and doubt."""

    best: Carried
    soft_iron_gain: float = 0.0
    doubt: Doubt | None = None


def choose_carried(
    start: Solution, carrier: Carrier, with_iron: Prior, *, always_iron: bool
) -> CarriedChoice:
    """Fit with soft iron and without, and take what is asked for."""
    plain = _with_or_without_offset(start, carrier)
    carrier = plain.carrier
    if not with_iron.has_soft_iron:
        return CarriedChoice(plain)
    look = _look_at(plain, with_iron)
    gain = look.gain
    # Where soft iron was taken for drift or outliers, the plain fit no longer shows its slope.
    honest = plain.drift < USUAL_DRIFT and plain.solution.believed.mean() > HONEST_SHARE
    if always_iron or not honest or look.gain > WORTH_A_FIT:
        iron = fit_carried(start, carrier, with_iron)
        without = _held_to(iron, carrier, start.problem.prior)
        gain = lasting_gain(without.cost - iron.cost, without.chi_square - iron.chi_square)
        # A gyro that drifts more than gyros do hides errors that last, which kappa does not see.
        kappa = iron.solution.problem.kappa * max(1.0, (iron.drift / USUAL_DRIFT) ** 2)
        asked = gain > look.price(SOFT_IRON_PRICE) * kappa
        if always_iron or (asked and keeps_samples(plain.solution, iron.solution)):
            return CarriedChoice(iron, gain)
    return CarriedChoice(plain, gain, Doubt(look, look.probability(gain)))


def _look_at(plain: Carried, with_iron: Prior) -> Look:
    """Return what soft iron would bring, from the slope at zero."""
    prior = without_axes(with_iron)
    task = Task(replace(plain.solution.problem, prior=prior), plain.carrier, plain.drift)
    equations = normal_equations(at(plain.solution.state, plain.coefficients, task), task)
    kappa = task.problem.kappa
    return look_for_soft_iron(equations.covariance, equations.gradient, prior, kappa)


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
    task = Task(problem, carrier, rich.drift)
    place = begin(Solution(State(shared, solution.state.attitude), problem), task)
    return converge_carried(place, task, tolerance=1e-5)


def begin(start: Solution, task: Task) -> Place:
    """Return the gyro's attitudes, turned so that they fit the start's on the whole."""
    shared, carrier = start.state.shared, task.carrier
    body = shared.body_axis @ start.state.attitude @ shared.world_axis.T
    counted = start.problem.weights.sample[:, None, None]
    total = np.sum(np.swapaxes(carrier.relative, 1, 2) @ (body * counted), axis=0)
    left, _, right = np.linalg.svd(total)
    first = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    attitude = shared.body_axis.T @ carrier.relative @ first @ shared.world_axis
    # The coefficients speak in the first sample's axes, the attitudes in the turn's frame.
    return at(State(shared, attitude), np.zeros(carrier.size), task)


def carried_weights(place: Place, problem: Problem, *, soft: bool) -> Weights:
    """Return Student weights on the way, a gate at the end."""
    noise = problem.noise
    chi = chi_squares(place.state, place.prediction, noise)
    if soft:
        return student_weights(chi, rigid=True)
    residual = np.concatenate(
        [place.prediction.up_residual / noise.up, place.prediction.field_residual / noise.field],
        axis=1,
    )
    return hard_weights(gate_residuals(residual, chi, np.zeros(len(residual))))
