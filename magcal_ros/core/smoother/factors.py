"""Factors: residuals of the measurements, and derivatives with respect to the unknowns.

A residual is the measurement minus its prediction; the derivatives are those of the prediction.
Attitudes are perturbed on the body's side, R <- exp(phi) R.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, wrap_angle
from magcal_ros.core.geometry.rotations import (
    crossed,
    exp_rotations,
    rotation_from_rpy,
    rotation_vectors,
    skew,
    skews,
)
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.places import Places
from magcal_ros.core.smoother.state import Course, State
from magcal_ros.core.smoother.unknowns import (
    AT,
    ATTITUDE,
    BIAS_UP,
    BODY_FIELD,
    CURRENT_LATE,
    EARTH,
    HEADING_DRIFT,
    HEADING_RATE,
    LOCAL,
    ROLL_PITCH,
    SHARED,
    SHIELDING,
    STREET,
    TURNED,
    VELOCITY,
    WAVES,
    YAW,
)

DEGREE = math.radians(1.0)

ELEMENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Row and column of each soft-iron parameter."""


def _element_matrices() -> FloatArray:
    out = np.zeros((6, 3, 3))
    for k, (row, column) in enumerate(ELEMENTS):
        out[k, row, column] = out[k, column, row] = 1.0
    return out


ELEMENT_MATRICES = _element_matrices()
LEVEL = np.diag([1.0, 1.0, 0.0])  # derivative of the soft iron by the shielding
X, Y, Z = np.eye(3)
LEVEL_AXES, UP_AXIS = slice(0, 2), slice(2, 3)  # components of a residual in body axes


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of one kind with their derivatives."""

    residual: FloatArray  # Shape (k, d)
    by_node: FloatArray  # derivatives by the unknowns of node k. Shape (k, d, LOCAL).
    by_next: FloatArray | None = None
    """By the unknowns of node k + 1, for residuals between neighbours. Shape (k, d, LOCAL)."""
    shared: FloatArray | None = None
    """By the shared unknowns; the last columns, of the centres of `Places`, may be missing. Shape
    (k, d, s)."""

    def part(self, components: slice) -> Residuals:
        """Return some components of the residuals."""
        rest = (
            None if each is None else each[:, components] for each in (self.by_next, self.shared)
        )
        return Residuals(self.residual[:, components], self.by_node[:, components], *rest)

    def times(self, matrices: FloatArray) -> Residuals:
        """Return the residuals, each multiplied by its matrix, shape (k, d, d)."""
        rest = (None if each is None else matrices @ each for each in (self.by_next, self.shared))
        residual = np.einsum("kij,kj->ki", matrices, self.residual)
        return Residuals(residual, matrices @ self.by_node, *rest)

    def by(self, free: IntArray) -> FloatArray:
        """Return the derivatives by the free shared unknowns, without missing columns."""
        assert self.shared is not None
        return self.shared[:, :, free[free < self.shared.shape[2]]]


def installation(shared: FloatArray) -> FloatArray:
    """Return the rotation from body axes to the magnetometer's, shape (3, 3)."""
    roll, pitch = shared[ROLL_PITCH]
    return rotation_from_rpy(roll, pitch, shared[YAW] + shared[TURNED]).T


def soft_iron(shared: FloatArray) -> FloatArray:
    """Return I + E, shape (3, 3)."""
    own = np.eye(3) + np.tensordot(shared[AT["soft_iron"]], ELEMENT_MATRICES, 1)
    return np.asarray(own + shared[SHIELDING] * LEVEL)


def gyro_matrix(shared: FloatArray) -> FloatArray:
    """Return the gyro's scale and misalignment, shape (3, 3)."""
    return shared[AT["gyro_matrix"]].reshape(3, 3)


def gyro_error(nodes: Nodes, shared: FloatArray) -> FloatArray:
    """Return the gyro's rotation error by bias and matrix, radians, shape (n - 1, 3)."""
    bias = nodes.seconds[:, None] * shared[AT["gyro_bias"]]
    bias[:, 2] += bias_waves(nodes) @ shared[AT["bias_walk"]]
    return np.asarray(bias + nodes.angle @ gyro_matrix(shared).T)


def bias_waves(nodes: Nodes) -> FloatArray:
    """Return the rotation between nodes by each wave of the bias walk, √s s, (n - 1, WAVES).

    A random walk over T seconds is a sum of independent waves sqrt(2 T) sin(w t / T) / w, with w =
    pi / 2, 3 pi / 2, ... (Karhunen and Loève).
    """
    window = np.ptp(nodes.time)
    phase = (np.arange(WAVES) + 0.5) * math.pi
    cosine = np.cos(phase * (nodes.time - nodes.time[0])[:, None] / window)
    return np.asarray(math.sqrt(2.0 * window) * window / phase**2 * (cosine[:-1] - cosine[1:]))


def turned_by(nodes: Nodes, shared: FloatArray) -> FloatArray:
    """Return the rotation between nodes by the corrected gyro, shape (n - 1, 3, 3)."""
    return np.asarray(exp_rotations(gyro_error(nodes, shared)) @ nodes.turned)


def distortion(shared: FloatArray) -> FloatArray:
    """Return the matrix from the Earth's field in body axes to the field in nominal axes."""
    return soft_iron(shared) @ installation(shared)


def motor_inputs(course: Course, shared: FloatArray) -> dict[str, FloatArray]:
    """Return the input of each group of unknowns of the motors' field, shapes (n, 1)."""
    nodes = course.nodes
    found = {"motors_moving": course.moving[:, None], "motors_rate": nodes.rate[:, 2:]}
    if nodes.currents is not None:
        found["motors_current"] = nodes.currents.at(shared[CURRENT_LATE])[:, None]
    return found


def magnetic(course: Course, state: State, places: Places) -> Residuals:
    """Return the residuals of the field at the nodes, µT (doc/smoother.md, the model)."""
    nodes, shared = course.nodes, state.shared
    angle, rate = nodes.turned_since(shared[AT["latency"]][0])
    late = exp_rotations(angle)
    attitude = late @ state.attitude
    earth = attitude @ state.earth
    ahead, gradient = state.attitude[:, 0, :2], shared[AT["gradient"]].reshape(3, 2)
    disturbance = places.disturbance(state) + ahead @ gradient.T + shared[AT["place"]]
    comes = course.added == 0.5
    added = (course.added + comes * shared[AT["came"]])[:, None]
    disturbance += added * shared[AT["entered"]]
    street = np.einsum("nij,nj->ni", attitude, disturbance)
    turn, bend = installation(shared), soft_iron(shared)
    full = bend @ turn
    by_earth, by_street = full @ nodes.inside, turn @ nodes.inside
    inside_earth = np.einsum("nij,nj->ni", nodes.inside, earth)
    inside_street = np.einsum("nij,nj->ni", nodes.inside, street)
    count, motors = len(nodes), motor_inputs(course, shared)
    of_the_body = {"iron": np.ones((count, 1)), **motors, "drift": course.span[:, None]}
    of_the_body["added"] = added
    predicted = inside_earth @ full.T + inside_street @ turn.T + state.local[:, BODY_FIELD]
    predicted += sum(share * shared[AT[name]] for name, share in of_the_body.items())
    by_node = np.zeros((count, 3, LOCAL))
    by_node[:, :, ATTITUDE] = -(by_earth @ skews(earth) + by_street @ skews(street)) @ late
    by_place = by_street @ attitude
    swung = np.swapaxes(state.attitude, 1, 2)[:, :2] @ skew(X)
    by_node[:, :, ATTITUDE] += by_place @ gradient @ swung
    by_node[:, :, STREET] = by_place * places.rest[:, None, None]
    by_node[:, :, BODY_FIELD] = np.eye(3)
    by = np.zeros((count, 3, SHARED + 3 * len(places)))
    by[:, :, SHARED:] = np.einsum("nk,nij->nikj", places.weights, by_place).reshape(count, 3, -1)
    on_the_way = by_place[:, :, :, None] * ahead[:, None, None, :]
    by[:, :, AT["gradient"]] = on_the_way.reshape(count, 3, 6)
    by[:, :, AT["place"]] = by_place
    by[:, :, AT["entered"]] = added[:, :, None] * by_place
    step = shared[AT["added"]] + by_place @ shared[AT["entered"]]
    by[:, :, AT["came"].start] = comes[:, None] * step
    for name, share in of_the_body.items():
        by[:, :, AT[name]] = share[:, :, None] * np.eye(3)
    if nodes.currents is not None:
        later = nodes.currents.change(shared[CURRENT_LATE])
        by[:, :, CURRENT_LATE] = later[:, None] * shared[AT["motors_current"]]
    by[:, :, EARTH] = (by_earth @ attitude)[:, :, 1:] * [1.0, -1.0]
    turned = inside_earth @ turn.T
    for k in range(6):
        by[:, :, AT["soft_iron"].start + k] = turned @ ELEMENT_MATRICES[k]
    by[:, :, SHIELDING] = turned @ LEVEL
    axes = {ROLL_PITCH.start: X, ROLL_PITCH.start + 1: _about_x(shared).T @ Y, YAW: turn @ Z}
    turned_street = inside_street @ turn.T
    for k, axis in axes.items():
        by[:, :, k] = crossed(turned, axis) @ bend.T + crossed(turned_street, axis)
    by[:, :, TURNED] = by[:, :, YAW]
    by[:, :, AT["latency"].start] = np.einsum(
        "nij,nj->ni", by_earth, crossed(rate, earth)
    ) + np.einsum("nij,nj->ni", by_street, crossed(rate, street))
    return Residuals(nodes.field - predicted, by_node, None, by)


def _about_x(shared: FloatArray) -> FloatArray:
    return rotation_from_rpy(float(shared[ROLL_PITCH.start]), 0.0)


QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])  # A quarter turn to the left in the level plane


def force(course: Course, state: State) -> Residuals:
    """Return the residuals of the specific force between nodes, m/s².

    A vehicle's velocity stays level while its body sways: its acceleration is computed in level
    axes. The lever arm rotates with the body.
    """
    nodes, shared = course.nodes, state.shared
    level, up = course.axes[:, :2], course.axes[:, 2]
    rate = nodes.link_rate - shared[AT["gyro_bias"]]
    turning = (rate @ up)[:, None]
    velocity = state.local[:, VELOCITY]
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    seconds = nodes.seconds[:, None]
    gravity = STANDARD_GRAVITY * state.attitude[:, :, 2]
    # Half by the attitude of each end, so that a gyro error between them is no error of force.
    along, back = 0.5 * nodes.along, 0.5 * nodes.along @ np.swapaxes(nodes.turned, 1, 2)
    spin = skews(rate)
    by_arm = spin @ spin + skews(nodes.swing)
    acceleration = (velocity[1:] - velocity[:-1]) / seconds + turning * mean @ QUARTER.T
    predicted = np.einsum("nij,nj->ni", along, gravity[:-1])
    predicted += np.einsum("nij,nj->ni", back, gravity[1:])
    predicted += acceleration @ level.T + by_arm @ shared[AT["lever_arm"]]
    moving = 0.5 * (course.moving[1:] + course.moving[:-1])[:, None]
    predicted += shared[AT["force_offset"]] + moving * shared[AT["force_moving"]]
    count = len(seconds)
    by_node, by_next = np.zeros((count, 3, LOCAL)), np.zeros((count, 3, LOCAL))
    by_node[:, :, ATTITUDE] = -along @ skews(gravity[:-1])
    by_next[:, :, ATTITUDE] = -back @ skews(gravity[1:])
    bend = 0.5 * turning[:, :, None] * (level @ QUARTER)
    by_node[:, :, VELOCITY] = bend - level / seconds[:, :, None]
    by_next[:, :, VELOCITY] = bend + level / seconds[:, :, None]
    by = np.zeros((count, 3, SHARED))
    by[:, :, AT["lever_arm"]] = by_arm
    by[:, :, AT["force_offset"]] = np.eye(3)
    by[:, :, AT["force_moving"]] = moving[:, :, None] * np.eye(3)
    by[:, :, AT["mounting_yaw"]] = (acceleration @ QUARTER.T @ level.T)[:, :, None]
    arm = shared[AT["lever_arm"]]
    sideways = mean @ QUARTER.T @ level.T
    # Of w x (w x r) and of the turning about up, with w = measured - bias.
    by[:, :, AT["gyro_bias"]] = (
        skews(crossed(rate, arm)) + spin @ skews(arm[None])[0] - sideways[:, :, None] * up
    )
    return Residuals(nodes.force - predicted, by_node, by_next, by)


def force_at_rest(measured: FloatArray, state: State) -> Residuals:
    """Return the residuals of the specific force at nodes at rest, (n, 3) in m/s²."""
    gravity = STANDARD_GRAVITY * state.attitude[:, :, 2]
    by_node = np.zeros((len(measured), 3, LOCAL))
    by_node[:, :, ATTITUDE] = -skews(gravity)
    by = np.zeros((len(measured), 3, SHARED))
    by[:, :, AT["force_offset"]] = np.eye(3)
    return Residuals(measured - gravity - state.shared[AT["force_offset"]], by_node, None, by)


def known_heading(heading: FloatArray, forward: FloatArray, state: State) -> Residuals:
    """Return the residuals of known headings at the nodes, radians.

    `heading` (n,) is the ENU yaw to magnetic north, radians, and `forward` (n, 3) its direction in
    body axes.
    """
    off, by_attitude = _heading_residual(heading, forward, state)
    by_node = np.zeros((len(heading), 1, LOCAL))
    by_node[:, 0, ATTITUDE] = by_attitude
    by_node[:, :, HEADING_DRIFT] = DEGREE
    return Residuals(wrap_angle(off[:, None] - DEGREE * state.local[:, HEADING_DRIFT]), by_node)


def known_turn(
    turned: FloatArray, seconds: FloatArray, forward: FloatArray, state: State
) -> Residuals:
    """Return the residuals of turns between nodes by the gyro, (n - 1,) radians to the left.

    `seconds` (n - 1,) are the durations over which the gyro's bias was integrated.
    """
    ahead, by_attitude = _heading_residual(np.zeros(len(forward)), forward, state)
    by_node, by_next = (np.zeros((len(turned), 1, LOCAL)) for _ in range(2))
    by_node[:, 0, ATTITUDE], by_next[:, 0, ATTITUDE] = -by_attitude[:-1], by_attitude[1:]
    by = np.zeros((len(turned), 1, SHARED))
    by[:, 0, BIAS_UP] = seconds
    # `ahead` is minus the heading.
    off = turned - seconds * state.shared[BIAS_UP] + ahead[1:] - ahead[:-1]
    return Residuals(wrap_angle(off)[:, None], by_node, by_next, by)


def _heading_residual(
    heading: FloatArray, forward: FloatArray, state: State
) -> tuple[FloatArray, FloatArray]:
    """Return headings minus those of a state, and the derivative of the latter by attitude."""
    east, north = state.attitude[:, :, 0], state.attitude[:, :, 1]
    x, y = np.sum(east * forward, axis=1), np.sum(north * forward, axis=1)
    turned = x[:, None] * np.cross(north, forward) - y[:, None] * np.cross(east, forward)
    return wrap_angle(heading - np.arctan2(y, x)), turned / (x**2 + y**2)[:, None]


def speed(measured: FloatArray, state: State, *, is_ahead: bool) -> Residuals:
    """Return the residuals of the wheels' speed, (n,) in m/s.

    The speed is along the body's x axis if `is_ahead`, else in any direction.
    """
    by_node = np.zeros((len(measured), 1, LOCAL))
    velocity = state.local[:, VELOCITY]
    if is_ahead:
        by_node[:, 0, VELOCITY.start] = 1.0
        known, modelled = measured, velocity[:, 0]
    else:
        known, modelled = np.abs(measured), np.linalg.norm(velocity, axis=1)
        by_node[:, 0, VELOCITY] = velocity / np.maximum(modelled, 1e-9)[:, None]
    return Residuals(np.where(np.isfinite(measured), known - modelled, 0.0)[:, None], by_node)


def gyro(course: Course, state: State) -> Residuals:
    """Return the residuals of the gyro's rotation between nodes, radians."""
    nodes, shared = course.nodes, state.shared
    error = gyro_error(nodes, shared)
    between = state.attitude[1:] @ np.swapaxes(state.attitude[:-1], 1, 2)
    off = rotation_vectors(between @ np.swapaxes(nodes.turned, 1, 2) @ exp_rotations(-error))
    count = len(error)
    by_node, by_next = np.zeros((count, 3, LOCAL)), np.zeros((count, 3, LOCAL))
    by_node[:, :, ATTITUDE] = -between
    by_next[:, :, ATTITUDE] = np.eye(3)
    by = np.zeros((count, 3, SHARED))
    by[:, :, AT["gyro_bias"]] = -nodes.seconds[:, None, None] * np.eye(3)
    by[:, 2, AT["bias_walk"]] = -bias_waves(nodes)
    for row in range(3):
        columns = AT["gyro_matrix"].start + 3 * row
        by[:, row, columns : columns + 3] = -nodes.angle
    return Residuals(-off, by_node, by_next, by)


def second_order(state: State, row: int, correlation: FloatArray, by: tuple[int, int]) -> Residuals:
    """Return the residuals of a process of second order, x[k + 1] = F x[k] + noise.

    `row` is the index of the unknown at the nodes. `correlation` (2, n - 1) are the coefficients F
    of the two unknowns `by` at the previous node.
    """
    values, count = state.local, len(state.local) - 1
    by_node, by_next = np.zeros((count, 1, LOCAL)), np.zeros((count, 1, LOCAL))
    residual = -values[1:, row]
    for share, column in zip(correlation, by, strict=True):
        residual = residual + share * values[:-1, column]
        by_node[:, 0, column] = -share
    by_next[:, 0, row] = 1.0
    return Residuals(residual[:, None], by_node, by_next)


def process(state: State, which: slice, correlation: FloatArray) -> Residuals:
    """Return the residuals of a Gauss-Markov process, x[k + 1] = keeps[k] x[k] + noise."""
    values = state.local[:, which]
    residual = correlation[:, None] * values[:-1] - values[1:]
    width = which.stop - which.start
    by_node, by_next = (np.zeros((len(correlation), width, LOCAL)) for _ in range(2))
    by_node[:, :, which] = -correlation[:, None, None] * np.eye(width)
    by_next[:, :, which] = np.eye(width)
    return Residuals(residual, by_node, by_next)


def heading_drift(state: State, correlation: FloatArray, seconds: FloatArray) -> Residuals:
    """Return the residuals of a heading drift: a Gauss-Markov process, plus a constant rate."""
    drift = process(state, HEADING_DRIFT, correlation)
    drift.by_node[:, :, HEADING_RATE] = -seconds[:, None, None]
    evenly = seconds[:, None] * state.local[:-1, HEADING_RATE]
    return replace(drift, residual=drift.residual + evenly)
