"""Fit all unknowns of one window for one kind of motion, or of several windows together."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.smoother.joint import Joint, agreed
from magcal_ros.core.smoother.model import Model, Point, course_at, prior_at, weigh
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.places import Places
from magcal_ros.core.smoother.priors import Priors
from magcal_ros.core.smoother.sizes import (
    Predicted,
    effect_factors,
    expected_square,
    noise_sizes,
    whole_field_factors,
)
from magcal_ros.core.smoother.solver import Solution, WeightedResiduals, log_determinant
from magcal_ros.core.smoother.state import State
from magcal_ros.core.smoother.unknowns import AT, ATTITUDE, EARTH, SHARED, KindOfMotion

STEPS = {EARTH.stop - 1: 0.1, AT["sway_arm"].stop - 1: 0.01}
"""Steps of derivatives by the downward field (µT) and by the height above the pivot (m)."""
NEGLIGIBLE = 20.0
"""Difference of minus twice the log evidence from which the worse of two fits has no weight."""
SETTLED = 0.2
"""Largest step of the answer, in its own sigmas, of a fit that counts as settled."""


@dataclass(frozen=True)
class Tolerances:
    """When the iterations stop."""

    rounds: int = 80  # steps at most
    fewest: int = 8  # steps at least
    step: float = 0.05  # of the answer (`answer_of`), in its own sigmas
    cost: float = 0.5  # change of what is minimised (`Joint.cost`)
    largest_turn: float = 0.4  # radians that a step may turn any node; longer steps are shortened
    places_at: int = 7  # round in which the places passed are computed; again at the optimum
    held: int = 3  # first rounds, in which the sigmas of effects keep their usual sizes
    gaussian: int = 5  # first rounds, in which residuals are Gaussian instead of Student
    ahead: int = 10
    """A fit ends if this many more rounds, each with the last gain, would not reach the limit."""
    undamped: int = 20  # first rounds, in which every step is taken in full


@dataclass(frozen=True, eq=False)
class Fit:
    """The optimum for one kind of motion."""

    kind: KindOfMotion
    model: Model
    point: Point
    covariance: FloatArray  # of the shared unknowns. Shape (SHARED, SHARED).
    evidence: float  # minus twice the logarithm of the evidence, up to a constant of the window
    weighted: dict[str, WeightedResiduals]  # the residuals at the optimum
    rounds: int
    converged: bool
    moved: float  # last step of the answer, in its own sigmas

    @property
    def state(self) -> State:
        """The unknowns."""
        return self.point.state

    @property
    def local_field(self) -> float:
        """Local disturbance and fluctuating field of the motors together, µT per axis."""
        return math.hypot(self.point.sizes["street"], self.point.sizes["motors_noise"])

    @property
    def is_settled(self) -> bool:
        """Whether the answer no longer changes."""
        # Velocities may alternate between two sets of outliers without an effect on the answer.
        return self.converged or self.moved < SETTLED

    @property
    def message(self) -> str:
        """Why the iterations stopped, in words."""
        return "converged" if self.is_settled else f"no convergence in {self.rounds} rounds"


def fit(
    nodes: Nodes,
    priors: Priors,
    start: State,
    kind: KindOfMotion,
    tolerances: Tolerances = Tolerances(),
    like: Fit | None = None,
    report: Callable[[int], object] | None = None,
    rival: float = math.inf,
) -> Fit | None:
    """Return the fit of a window by Gauss-Newton steps, with the sizes of noises and effects.

    The priors are those about the start. `like` is the optimum of another kind of motion to start
    from, or a fit of this kind to continue. `report` is called with the number of each round.
    `rival` is the evidence at which a competing fit has the same weight; the iterations end early
    if they cannot come near it. None if a matrix is not positive definite.
    """
    limit = rival + NEGLIGIBLE
    # A fit that continues one at its optimum keeps its places: their evidences are compared.
    keeps = like is not None and like.kind == kind and like.converged
    try:
        model = Model.of(nodes, priors, start, kind)
        point, first = _begin(model, start, kind, tolerances, like)
        found = optimum([model], [point], tolerances, first, report, limit, keeps_places=keeps)
        return found.fits([kind])[0]
    except np.linalg.LinAlgError:
        return None


def without_distortion(found: Fit) -> Fit:
    """Return a fit as the start of another, whose soft iron and axes are as usual at first."""
    groups = {**found.point.groups, "axes": 1.0, "soft_iron": 1.0}
    return replace(found, point=replace(found.point, groups=groups))


@dataclass(frozen=True, eq=False)
class Optimum:
    """Where the iterations of one or several windows ended."""

    models: list[Model]
    points: list[Point]
    joint: Joint  # the last step, which is not taken
    wide: list[Point]  # the points with the root mean squares of the sizes under their posterior
    widened: Joint  # the covariance at `wide`
    evidence: float
    rounds: int
    converged: bool
    moved: float

    def fits(self, kinds: Sequence[KindOfMotion]) -> list[Fit]:
        """Return the fit of each window, with its covariance."""
        end, out = (self.rounds, self.converged, self.moved), []
        for k, (kind, model) in enumerate(zip(kinds, self.models, strict=True)):
            free, covariance = model.free, np.zeros((SHARED, SHARED))
            known = self.widened.solutions[k].covariance[: len(free), : len(free)]
            covariance[np.ix_(free, free)] = known
            parts = self.joint.weighted[k]
            out.append(Fit(kind, model, self.points[k], covariance, self.evidence, parts, *end))
        return out


def optimum(
    models: Sequence[Model],
    points: Sequence[Point],
    tolerances: Tolerances,
    first: int = 0,
    report: Callable[[int], object] | None = None,
    limit: float = math.inf,
    *,
    keeps_places: bool = False,
) -> Optimum:
    """Iterate from initial points to the optimum of all windows.

    `first` is the number of the first round. The iterations end early if the evidence will not come
    below `limit`. With `keeps_places` the places passed are not found again at the optimum.
    Raises `numpy.linalg.LinAlgError` if a matrix is not positive definite.
    """
    models, points, fewest = list(models), list(points), min(tolerances.fewest, tolerances.rounds)
    sizes, before, damping = [SizeSteps() for _ in models], math.inf, Damping()
    is_current = keeps_places or not any(model.travels for model in models)
    for rounds in range(first, tolerances.rounds + 1):
        if report is not None:
            report(rounds)
        if rounds == tolerances.places_at:
            points = [with_places(*each) for each in zip(models, points, strict=True)]
        joint = Joint.at(models, points)
        solutions = joint.solutions
        cost = joint.cost(models, points) if rounds >= fewest else math.inf
        evidence = cost + joint.log_curvature
        share = min(share_of(each, tolerances) for each in solutions)
        answer = np.concatenate([answer_of(*each) for each in zip(models, solutions, strict=True)])
        moved = float(np.abs(answer).max(initial=0.0))
        is_settled = rounds > fewest and share == 1.0 and moved < tolerances.step
        converged = is_settled and is_current and abs(cost - before) < tolerances.cost
        if rounds == tolerances.rounds or converged:
            break
        if is_settled and not is_current:
            # The path has changed since its places were found.
            points = [with_places(*each) for each in zip(models, points, strict=True)]
            is_current, before, damping = True, math.inf, Damping()
            continue
        ahead = min(tolerances.ahead, tolerances.rounds - rounds)
        if rounds > fewest and 0.0 <= (before - cost) * ahead < evidence - limit:
            break
        before = cost
        if rounds > tolerances.undamped:
            damping = damping.next(cost)
        for k, (model, point, solution) in enumerate(zip(models, points, solutions, strict=True)):
            if rounds >= tolerances.gaussian:
                point = _robust(model, point, joint.weighted[k], solution)
            if rounds > 0:
                sizes[k], point = sizes[k].next(model, point, solution, joint.predicted[k])
            stands = stepped(model, point, solution, share * damping.share)
            if rounds >= tolerances.held:
                # The factors follow from the posterior mean: the point after a whole step.
                whole = stepped(model, point, solution, share) if damping.share < 1.0 else stands
                stands = replace(stands, groups=effect_factors(model, whole, solution))
            points[k] = stands
        points = agreed(models, points)
    return _with_covariance(models, points, joint, evidence, (rounds, converged, moved))


def _with_covariance(
    models: list[Model],
    points: list[Point],
    joint: Joint,
    evidence: float,
    end: tuple[int, bool, float],
) -> Optimum:
    """Return the optimum with its covariance, under the mixture prior of the Earth's field.

    `end` are the rounds, whether they converged, and the last step of the answer.
    """
    windows = list(zip(models, points, joint.solutions, strict=True))
    both = zip(windows, joint.predicted, strict=True)
    wide = agreed(models, [_widened(*each, predicted) for each, predicted in both])
    widened = Joint.at(models, wide, is_expected=True)
    if not models[0].priors.fields.is_known:
        means = [earth_of(*each) for each in windows]
        joint, gain = _with_mixture(models, joint, means)
        widened, _ = _with_mixture(models, widened, means)
        taken = zip(models, points, joint.solutions, strict=True)
        points = [stepped(model, point, solution, 1.0) for model, point, solution in taken]
        evidence -= 2.0 * gain
    return Optimum(models, points, joint, wide, widened, evidence, *end)


def earth_of(model: Model, point: Point, solution: Solution) -> FloatArray:
    """Return the posterior mean of level and downward field, µT, shape (2,)."""
    return np.asarray(point.state.shared[EARTH] + solution.shared[model.rows_of_earth])


def _with_mixture(
    models: Sequence[Model], joint: Joint, means: Sequence[FloatArray]
) -> tuple[Joint, float]:
    """Return the step to the optimum under the mixture prior of the Earth's field, and its gain.

    The iterations use one wide Gaussian, because with a mixture they could end at any component.
    `means` are the posterior means of level and downward field (2,) under this Gaussian. The gain
    is in log evidence; all windows share the field, and so the gain.
    """
    found, gain = [], 0.0
    for model, solution, mean in zip(models, joint.solutions, means, strict=True):
        at, known = model.rows_of_earth, solution.covariance
        spread = known[np.ix_(at, at)]
        shift, wanted, gain = model.priors.fields.updated(model.earth, mean, spread)
        by_earth = np.linalg.solve(spread, known[at]).T
        covariance = known + by_earth @ (wanted - spread) @ by_earth.T
        moved = by_earth @ shift
        local = -solution.follow @ moved
        found.append(replace(solution, local=local, shared=moved, covariance=covariance))
    return replace(joint, solutions=found), gain


def _robust(
    model: Model, point: Point, weighted: dict[str, WeightedResiduals], solution: Solution
) -> Point:
    """Return the point with Student residuals; without a gyro all tilts are marginalised."""
    point = replace(point, is_robust=True)
    if model.nodes.tied_to is None:
        return point
    gradient = marginal_gradient(model, point, weighted, solution)
    if point.marginal is not None:
        # The curvature of this cost is not part of the step: whole steps may diverge.
        gradient = 0.5 * (gradient + point.marginal)
    return replace(point, marginal=gradient)


def marginal_gradient(
    model: Model, point: Point, weighted: dict[str, WeightedResiduals], solution: Solution
) -> FloatArray:
    """Return the gradient of the log determinant of the nodes' information matrix.

    Shape (SHARED,), by the downward field and the height of the accelerometer. Both multiply the
    tilts: the joint optimum underestimates the tilts and overestimates both (Neyman and Scott,
    Econometrica 16, 1948). `weighted` and `solution` are the residuals and the step at the point.
    """
    prior, out = prior_at(model, point), np.zeros(SHARED)
    for which, step in STEPS.items():
        shared = point.state.shared.copy()
        shared[which] += step
        moved = weigh(model, replace(point, state=replace(point.state, shared=shared)))
        case = [
            replace(part, linear=replace(moved[name].linear, residual=part.linear.residual))
            for name, part in weighted.items()
        ]
        out[which] = (log_determinant(case, prior) - solution.chain.log_determinant) / step
    return out


def _begin(
    model: Model, start: State, kind: KindOfMotion, tolerances: Tolerances, like: Fit | None
) -> tuple[Point, int]:
    """Return the first point and the number of the first round."""
    if like is None:
        return Point.begin(model, start), 0
    if like.kind == kind:
        return like.point, tolerances.places_at + 1
    return like.point.moved_to(model), tolerances.gaussian


def share_of(solution: Solution, tolerances: Tolerances) -> float:
    """Return the share of a step that is taken, 0 to 1."""
    largest = float(np.abs(solution.local[:, ATTITUDE]).max())
    return min(1.0, tolerances.largest_turn / max(largest, 1e-9))


def answer_of(model: Model, solution: Solution) -> FloatArray:
    """Return the step of the answer (hard and soft iron, installation, axes), in its sigmas."""
    answer = np.flatnonzero(model.free < AT["axes"].stop)
    sigma = np.sqrt(np.diag(solution.covariance)[answer])
    return np.asarray(solution.shared[answer] / sigma)


@dataclass(frozen=True)
class Damping:
    """The share of a step that is taken: less after a step that made the cost larger."""

    share: float = 1.0
    cost: float = math.inf

    def next(self, cost: float) -> Damping:
        """Return the share of the next step, by the cost after the last one."""
        worse = cost > self.cost
        return Damping(0.5 * self.share if worse else min(1.0, 1.5 * self.share), cost)


def stepped(model: Model, point: Point, solution: Solution, share: float) -> Point:
    """Return the point after a Gauss-Newton step."""
    shared = np.zeros(SHARED + 3 * len(point.places))
    free = len(model.free)
    shared[model.free] = solution.shared[:free]
    shared[SHARED:] = solution.shared[free:]
    state = point.state.moved(share * solution.local, share * shared)
    if state.is_backward and model.nodes.tied_to is None:
        # If the start is off by half a turn, the level field passes through zero.
        state = state.turned_about()
    return replace(point, state=state, course=course_at(model, state))


def with_places(model: Model, point: Point) -> Point:
    """Return the point with centres of places along the current path, if the robot travels."""
    if not model.travels:
        return point
    places = Places.along(point.course, point.state, model.priors.lengths.street)
    state = places.with_disturbance(point.state, point.places.disturbance(point.state))
    return replace(point, places=places, state=state)


@dataclass(frozen=True)
class SizeSteps:
    """The last step of the noise sizes, to shorten alternating steps."""

    pace: dict[str, float] | None = None
    steps: dict[str, float] | None = None

    def next(
        self, model: Model, point: Point, solution: Solution, predicted: Predicted
    ) -> tuple[SizeSteps, Point]:
        """Return the step and the point after it."""
        wanted, _ = noise_sizes(model, point, solution, predicted)
        pace, steps = {}, {}
        for name, size in wanted.items():
            step = math.log(size / point.sizes[name])
            before = (self.steps or {}).get(name, 0.0)
            last = (self.pace or {}).get(name, 1.0)
            pace[name] = 0.5 * last if step * before < 0.0 else min(2.0, 1.3 * last)
            steps[name] = pace[name] * step
        sizes = {name: size * math.exp(steps.get(name, 0.0)) for name, size in point.sizes.items()}
        return SizeSteps(pace, steps), replace(
            point, sizes=sizes, velocity_variance=predicted.velocity
        )


def _widened(model: Model, point: Point, solution: Solution, predicted: Predicted) -> Point:
    """Return the point with the root mean squares of the sizes, for the covariance.

    The yaw error of non-orthogonal axes is known from the size of the soft iron only, whose mean
    square is used. The motors' field may be a step, or proportional to the rate or the current. A
    steady turn cannot separate these: each may be as large as their sum.
    """
    _, shown = noise_sizes(model, point, solution, predicted)
    wide = {
        name: expected_square(size, shown.get(name, 0.0), model.priors.sizes[name])
        for name, size in point.sizes.items()
    }
    expected = effect_factors(model, point, solution, frozenset({"soft_iron"}))
    groups = point.groups | {name: expected[name] for name in ("soft_iron", "axes")}
    groups |= whole_field_factors(point)
    return replace(point, sizes=wide, groups=groups)
