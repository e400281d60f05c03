"""The model at a point: residuals with their variances, and priors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray
from magcal_ros.core.smoother import factors
from magcal_ros.core.smoother import factors_of_motion as motion
from magcal_ros.core.smoother.currents import scale_by_current
from magcal_ros.core.smoother.earth import GaussianEarthPrior
from magcal_ros.core.smoother.factors import LEVEL_AXES, UP_AXIS, Residuals
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.places import Places
from magcal_ros.core.smoother.priors import Priors
from magcal_ros.core.smoother.solver import Prior, Solution, WeightedResiduals, solve
from magcal_ros.core.smoother.state import Course, State, damped
from magcal_ros.core.smoother.unknowns import (
    ACCELERATION,
    AT,
    BODY_FIELD,
    EARTH,
    KINDS,
    MOTORS,
    ON_THE_SPOT,
    RATE,
    SHARED,
    STREET,
    UNKNOWNS,
    VELOCITY,
    KindOfMotion,
)

GAUSSIAN = 1e9  # degrees of freedom at which a Student distribution is Gaussian
LEAST_VARIANCE = 1e-9  # added to the variance of the processes' steps, which would be zero at rest

CHANGES = "acceleration", "slip"  # the sizes of the change of velocity, ahead and sideways
VELOCITIES = "velocity ahead", "velocity sideways"  # residuals without an estimated size

LARGEST_MOTORS = UNKNOWNS["motors_moving"].sigma[0] * UNKNOWNS["motors_moving"].most  # µT per axis


@dataclass(frozen=True, eq=False)
class Model:
    """Constants of the iterations."""

    nodes: Nodes
    priors: Priors
    kind: KindOfMotion
    earth: GaussianEarthPrior  # the Gaussian of the iterations

    @classmethod
    def of(cls, nodes: Nodes, priors: Priors, start: State, kind: KindOfMotion) -> Model:
        """Return the model of a window for one kind of motion."""
        scale = priors.scale
        scales: dict[str, FloatArray | float] = {
            "lever_arm": scale[AT["lever_arm"]] * kind.lever_arm / UNKNOWNS["lever_arm"].sigma[0],
            "gradient": scale[AT["gradient"]] * kind.gradient,
        }
        if not kind.has_wheels:
            scales["mounting_yaw"] = 0.0
        if not kind.traffic:
            # A turn is too short for the gyro's bias to change.
            scales["bias_walk"] = 0.0
        if nodes.currents is not None and scale[AT["motors_moving"]].all():
            sigma = np.array(UNKNOWNS["motors_current"].sigma)
            scales["motors_current"] = sigma / nodes.currents.battery.largest
            scales["current_late"] = UNKNOWNS["current_late"].sigma[0]
        # On wheels the velocity changes less sideways than ahead.
        accelerations = zip(CHANGES, kind.accelerations, strict=True)
        begins = {n: priors.sizes[n]._replace(start=size) for n, size in accelerations}
        own = replace(
            priors.with_scales(scales),
            spread={**priors.spread, **dict.fromkeys(MOTORS, kind.motors)},
            iron_over_axes=priors.iron_over_axes * kind.soft_iron,
            sizes={**priors.sizes, **begins},
        )
        return cls(nodes, own, kind, priors.fields.about(start.shared[EARTH]))

    @property
    def rows_of_earth(self) -> IntArray:
        """Indices of level and downward field among the free unknowns, shape (2,)."""
        return np.searchsorted(self.free, np.arange(EARTH.start, EARTH.stop))

    @property
    def travels(self) -> bool:
        """Whether the kind of motion leaves the spot."""
        return self.kind.speed > KINDS[ON_THE_SPOT].speed

    @property
    def no_places(self) -> Places:
        """No centres; without a gyro no local disturbance at the nodes either."""
        none = Places.none(len(self.nodes), self.priors.lengths.street)
        return none if self.nodes.tied_to is None else replace(none, rest=np.zeros(len(self.nodes)))

    def scales(self, groups: dict[str, float]) -> FloatArray:
        """Return the sigmas of the shared unknowns' priors, shape (SHARED,)."""
        scale = self.priors.scale.copy()
        for name, at in AT.items():
            scale[at] *= groups[name]
        return scale

    @property
    def free(self) -> IntArray:
        """Indices of the free shared unknowns, without the centres of places."""
        return self.priors.free


@dataclass(frozen=True, eq=False)
class Point:
    """A value of all unknowns and of the sizes of noises and effects."""

    state: State
    course: Course
    sizes: dict[str, float]  # of the noises (`SIZES`)
    groups: dict[str, float]  # factors of the sigmas of the shared unknowns (`Unknown`)
    places: Places
    velocity_variance: FloatArray = field(repr=False)
    """Variance of the nodes' velocities, both axes together, (m/s)². Shape (n,)."""
    marginal: FloatArray | None = field(default=None, repr=False)
    """Gradient by the shared unknowns of the log determinant of the nodes' information matrix, to
    estimate them with the nodes marginalised. Shape (SHARED,)."""
    is_robust: bool = False
    """Whether residuals follow Student distributions. At first they are Gaussian: the few residuals
    that show an effect, such as rests for the motors, would count as outliers."""

    @classmethod
    def begin(cls, model: Model, state: State) -> Point:
        """Return the initial point of the iterations."""
        return cls(
            state,
            course_at(model, state),
            {
                name: size.usual if math.isnan(size.start) else size.start
                for name, size in model.priors.sizes.items()
            },
            _usual_groups(model.priors, state),
            model.no_places,
            np.full(len(model.nodes), float(model.kind.velocity @ model.kind.velocity)),
        )

    @property
    def body_field_at_first(self) -> float:
        """Size of the body's coloured noise at the first node, µT."""
        return self.sizes["body_field" if self.course.still[0] else "motors_noise"]

    def freedom(self, model: Model, name: str) -> float:
        """Return the degrees of freedom of a noise's Student distribution."""
        return model.priors.sizes[name].freedom if self.is_robust else GAUSSIAN

    def moved_to(self, model: Model) -> Point:
        """Return the same values as an initial point for another kind of motion."""
        places = model.no_places
        state = places.with_disturbance(self.state, self.places.disturbance(self.state))
        local = state.local.copy()
        local[:, VELOCITY] *= np.minimum(
            1.0, model.kind.velocity / np.maximum(np.abs(local[:, VELOCITY]).max(axis=0), 1e-9)
        )
        return replace(self, state=replace(state, local=local), places=places)


def _usual_groups(priors: Priors, state: State) -> dict[str, float]:
    """Return the initial factors of the groups' sigmas: larger where the start exceeds a sigma."""
    found = dict.fromkeys(AT, 1.0)
    for name, at in AT.items():
        scale = priors.scale[at]
        if priors.spread[name] > 0.0 and scale.all():
            off = (state.shared - priors.mean)[at] / scale
            found[name] = float(np.clip(np.sqrt(np.mean(off**2)), 1.0, priors.most[name]))
    return found


def course_at(model: Model, state: State) -> Course:
    """Return the course: where the robot rests, given the gyro's bias of a state."""
    bias = state.shared[AT["gyro_bias"]]
    return Course.of(model.nodes, state.mean_axes, bias, model.priors.lengths)


def _measured(
    model: Model,
    point: Point,
    name: str,
    linear: Residuals,
    scale: FloatArray,
    more: FloatArray | float = 0.0,
    others: Sequence[tuple[str, BoolArray]] = (),
) -> WeightedResiduals:
    """Weight residuals of one noise by the inverse of the variance size² `scale` + `more`.

    An infinite scale (k,) leaves a residual out. `others` are other noises, each of some residuals
    (k,), instead of this one.
    """
    size: FloatArray | float = point.sizes[name]
    freedom: FloatArray | float = point.freedom(model, name)
    sized = {name: np.ones(len(scale), dtype=np.bool_)}
    for other, rows in others:
        size = np.where(rows, point.sizes[other], size)
        freedom = np.where(rows, point.freedom(model, other), freedom)
        sized = {**sized, name: sized[name] & ~rows, other: rows}
    return WeightedResiduals(linear, size**2 * scale + more, freedom, sized)


def weigh(model: Model, point: Point) -> dict[str, WeightedResiduals]:
    """Return all residuals with their variances."""
    nodes, lengths, sizes, state = model.nodes, model.priors.lengths, point.sizes, point.state
    seconds, places, course = nodes.seconds, point.places, point.course
    measured = partial(_measured, model, point)
    per_node = (nodes.usual_count + (nodes.noise / sizes["field"]) ** 2) / nodes.count
    # At a start or stop, the fraction of the node in which motors run is uniform in 0 to 1.
    per_node = per_node + course.edge * (LARGEST_MOTORS / sizes["field"]) ** 2 / 12.0
    with np.errstate(divide="ignore"):
        per_link = nodes.usual_samples / nodes.samples

    field = factors.magnetic(course, state, places)
    most = 0.0 if point.is_robust else LARGEST_MOTORS / math.sqrt(12.0)
    variance = sizes["field"] ** 2 * per_node
    scale = scale_by_current(nodes.currents, state.shared, variance, most)
    field = field if scale is None else field.times(scale)
    # The fluctuation of running motors is independent of the field in the rest before or after.
    still = course.still
    correlation = np.exp(-seconds / lengths.body_field) * (still[1:] == still[:-1])
    found = {
        "field": measured("field", field, per_node),
        "body_field": measured(
            "motors_noise",
            factors.process(state, BODY_FIELD, correlation),
            1.0 - correlation**2,
            LEAST_VARIANCE,
            [("body_field", still[1:])],
        ),
    }
    if nodes.tied_to is not None:
        return found | _of_a_turn_without_gyro(model, point)
    if nodes.speed is not None:
        known = np.where(np.isfinite(nodes.speed), 1.0, math.inf)
        found["speed"] = measured(
            "speed", motion.speed(nodes.speed, state, is_ahead=model.kind.has_wheels), known
        )
    force, gyro, unseen = motion.force(course, state), motion.gyro(course, state), nodes.unseen
    used = {"gyro": LEVEL_AXES, "gyro_up": UP_AXIS}
    if "lean" in model.priors.sizes:
        del used["gyro"]  # If a level axis is dead, neither is used.
        found["lean"] = _lean(model, point, np.eye(3))
    for name, axes in used.items():
        found[name] = measured(name, gyro.part(axes), seconds, unseen[:, axes].mean(axis=1))
    stands = still[1:] & still[:-1] & model.kind.traffic
    correlation = np.where(stands, 1.0, np.exp(-path_between(model, point) / places.length))
    again = places.is_repeated
    return found | {
        "force": measured("force", force.part(LEVEL_AXES), per_link),
        "force_up": measured("force_up", force.part(UP_AXIS), per_link),
        "street": measured(
            "street",
            factors.process(state, STREET, correlation),
            np.where(stands, seconds, 1.0 - correlation**2),
            LEAST_VARIANCE,
            [("revisited", again[1:] & again[:-1] & ~stands), ("traffic", stands)],
        ),
        **_motion(model, point, 0),
        **_motion(model, point, 1),
    }


def _motion(model: Model, point: Point, axis: int) -> dict[str, WeightedResiduals]:
    """Return the prior residuals of velocity and acceleration along one level axis.

    The velocity v and its change a follow dv/dt = a, da/dt = -d a - (A / V)^2 v + noise. V and A
    are their usual sizes. The damping d is 1 / T, but at least critical.
    """
    seconds, name = model.nodes.seconds, CHANGES[axis]
    speed, size = model.kind.velocity[axis], point.sizes[name]
    pace = size / speed
    damping = max(1.0 / model.priors.lengths.acceleration, 2.0 * pace)
    by_v, by_a = damped(seconds, damping, pace)
    v_square = speed**2 * (1.0 - by_v[0] ** 2) - size**2 * by_v[1] ** 2
    a_square = size**2 * (1.0 - by_a[1] ** 2) - speed**2 * by_a[0] ** 2
    found = {}
    for kind, correlation, variance, column in (
        (VELOCITIES[axis], by_v, v_square, VELOCITY),
        (name, by_a, a_square, ACCELERATION),
    ):
        by = VELOCITY.start + axis, ACCELERATION.start + axis
        linear = factors.second_order(point.state, column.start + axis, correlation, by)
        sized = {kind: np.ones(len(seconds), dtype=bool)} if kind == name else {}
        found[kind] = WeightedResiduals(
            linear, np.maximum(variance, 0.0) + LEAST_VARIANCE, point.freedom(model, name), sized
        )
    return found


def _of_a_turn_without_gyro(model: Model, point: Point) -> dict[str, WeightedResiduals]:
    """Return the residuals of force, steady turning and sway of a turn without a gyro."""
    nodes, course, state = model.nodes, point.course, point.state
    assert nodes.tied_to is not None
    per_node = nodes.usual_count / nodes.count[:-1]
    force = motion.force_at_nodes(course, state)
    # At starts and stops the motors turn the field, which looks like a turn of the robot.
    starts = course.still[1:] != course.still[:-1]

    sized = partial(_measured, model, point, more=1e-3 * LEAST_VARIANCE)
    return {
        "force": sized("force", force.part(LEVEL_AXES), per_node),
        "force_up": sized("force_up", force.part(UP_AXIS), per_node),
        "lean": _lean(model, point, nodes.tied_to),
        "gyro_up": sized(
            "gyro_up",
            motion.turning(course, state, nodes.tied_to),
            np.where(starts, math.inf, nodes.seconds),
        ),
        "speed_change": sized("speed_change", motion.sway(course, state), np.ones(len(per_node))),
        "rate_change": sized(
            "rate_change", factors.process(state, RATE, np.ones(len(per_node))), nodes.seconds
        ),
    }


def _lean(model: Model, point: Point, axes: FloatArray) -> WeightedResiduals:
    """Return the prior residuals of the tilt off the robot's axis."""
    correlation = np.exp(-model.nodes.seconds / model.kind.tilted)
    linear = motion.lean(point.state, axes, correlation)
    return _measured(model, point, "lean", linear, 1.0 - correlation**2, 1e-3 * LEAST_VARIANCE)


def path_between(model: Model, point: Point) -> FloatArray:
    """Return the path of the magnetometer between nodes, m, (n - 1,), by the RMS velocity."""
    velocity, nodes, moving = point.state.local[:, VELOCITY], model.nodes, point.course.moving
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    square = np.sum(mean**2, axis=1) + 0.5 * (
        point.velocity_variance[1:] + point.velocity_variance[:-1]
    )
    around = model.priors.lengths.beside * np.linalg.norm(nodes.link_rate, axis=1)
    share = 0.5 * (moving[1:] + moving[:-1])
    return np.asarray(nodes.seconds * np.sqrt(square + around**2) * share + 1e-6)


def prior_at(model: Model, point: Point) -> Prior:
    """Return the priors at a point."""
    state, sizes, places = point.state, point.sizes, point.places
    local = np.full_like(state.local, LEAST_VARIANCE)
    local[0, VELOCITY] = model.kind.velocity**-2.0
    local[0, STREET] = sizes["street"] ** -2.0
    local[0, BODY_FIELD] = point.body_field_at_first**-2.0
    local[0, ACCELERATION] = [sizes[name] ** -2.0 for name in CHANGES]
    local[point.course.still, VELOCITY] = model.priors.lengths.creep**-2.0
    count = SHARED + 3 * len(places)
    information = np.zeros((count, count))
    free = model.free
    information[free, free] = model.scales(point.groups)[free] ** -2.0
    information[EARTH, EARTH] = model.earth.information
    for axis in range(3):
        of_axis = slice(SHARED + axis, None, 3)
        information[of_axis, of_axis] = places.information / sizes["street"] ** 2
    offset = np.concatenate([model.priors.mean - state.shared, -state.centres.ravel()])
    offset[EARTH] = model.earth.mean - state.shared[EARTH]
    counted = counted_unknowns(model, places)
    known, offset = information[np.ix_(counted, counted)], offset[counted]
    if point.marginal is not None:
        offset = offset - 0.5 * np.linalg.solve(known, point.marginal[counted])
    return Prior(local, -state.local, known, offset)


def counted_unknowns(model: Model, places: Places) -> IntArray:
    """Return the indices of the solved shared unknowns: the free ones, then the centres."""
    return np.concatenate([model.free, np.arange(SHARED, SHARED + 3 * len(places))])


def solve_at(
    model: Model, point: Point, *, is_expected: bool = False
) -> tuple[dict[str, WeightedResiduals], Solution]:
    """Return the residuals at a point, and the step or the covariance there.

    Raises `numpy.linalg.LinAlgError` if the matrix is not positive definite.
    """
    weighted = weigh(model, point)
    if is_expected:
        weighted = {name: replace(part, is_expected=True) for name, part in weighted.items()}
    counted = counted_unknowns(model, point.places)
    return weighted, solve(list(weighted.values()), prior_at(model, point), counted)
