"""Factors of the robot's motion: force, gyro and speed, and those of a turn without a gyro."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.core.geometry.rotations import crossed, exp_rotations, rotation_vectors, skew, skews
from magcal_ros.core.smoother.factors import Residuals, Z
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.state import Course, State
from magcal_ros.core.smoother.unknowns import AT, ATTITUDE, CLIMB, RATE, VELOCITY, WAVES

QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])  # A quarter turn to the left in the level plane


def acceleration(
    course: Course,
    state: State,
    axes: FloatArray,
    rate: FloatArray,
    swing: FloatArray,
    moving: FloatArray,
) -> tuple[Residuals, FloatArray]:
    """Return the specific force between nodes beyond gravity, in place of residuals.

    The second value is the change of the velocity alone, in level axes, shape (k, 2). Both are in
    m/s².

    A vehicle's velocity stays level while its body sways: its acceleration is computed in level
    axes. The lever arm rotates with the body. `axes` (k, 3, 3) are the vehicle's axes in body axes.
    `rate` and `swing` (k, 3) are turn rate and its change, rad/s and rad/s²; `moving` (k,) is the
    fraction of the time in motion.
    """
    shared, seconds = state.shared, course.nodes.seconds[:, None]
    level, up = axes[:, :, :2], axes[:, :, 2]
    turning, velocity = np.sum(rate * up, axis=1)[:, None], state.local[:, VELOCITY]
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    spin, arm, share = skews(rate), shared[AT["lever_arm"]], moving[:, None]
    by_arm = spin @ spin + skews(swing)
    change = (velocity[1:] - velocity[:-1]) / seconds + turning * mean @ QUARTER.T
    force = np.einsum("kij,kj->ki", level, change) + by_arm @ arm
    force += shared[AT["force_offset"]] + share * shared[AT["force_moving"]]
    bend = 0.5 * turning[:, :, None] * (level @ QUARTER)
    sideways = np.einsum("kij,kj->ki", level, mean @ QUARTER.T)
    by = {
        "lever_arm": by_arm,
        "force_offset": np.eye(3),
        "force_moving": share[:, :, None] * np.eye(3),
        "mounting_yaw": np.einsum("kij,kj->ki", level, change @ QUARTER.T)[:, :, None],
        # Of w x (w x r) and of the turning about up, with w = measured - bias.
        "gyro_bias": skews(crossed(rate, arm))
        + spin @ skew(arm)
        - sideways[:, :, None] * up[:, None],
    }
    by_change = level / seconds[:, :, None]
    found = Residuals(force, [(VELOCITY, bend - by_change)], [(VELOCITY, bend + by_change)], by)
    return found, change


def force(course: Course, state: State) -> Residuals:
    """Return the residuals of the specific force between nodes, m/s².

    Gravity and the acceleration of the vehicle rotate in the body as it sways.
    """
    nodes, axes = course.nodes, state.vehicle_axes
    # Half by the attitude of each end, so that a gyro error between them is no error of force.
    along, back = 0.5 * nodes.along, 0.5 * nodes.along @ np.swapaxes(nodes.turned, 1, 2)
    rate = nodes.link_rate - state.shared[AT["gyro_bias"]]
    swing = np.diff(nodes.rate, axis=0) / nodes.seconds[:, None]
    moving = 0.5 * (course.moving[1:] + course.moving[:-1])
    between = along @ axes[:-1] + back @ axes[1:]
    found, change = acceleration(course, state, between, rate, swing, moving)
    predicted, by_attitude = found.residual, []
    for rotation, end in ((along, axes[:-1]), (back, axes[1:])):
        up = end[:, :, 2]
        changes = np.einsum("kij,kj->ki", end[:, :, :2], change)
        predicted = predicted + STANDARD_GRAVITY * np.einsum("kij,kj->ki", rotation, up)
        # The level axes do not turn about up with the body.
        across = np.eye(3) - up[:, :, None] * up[:, None]
        swung = STANDARD_GRAVITY * skews(up) + skews(changes) @ across
        by_attitude.append([(ATTITUDE, -rotation @ swung)])
    node, later = by_attitude
    return Residuals(
        nodes.force - predicted, [*node, *found.node], [*later, *found.later], found.shared
    )


def gyro_error(nodes: Nodes, shared: FloatArray) -> FloatArray:
    """Return the gyro's rotation error by bias and matrix, radians, shape (n - 1, 3)."""
    bias = nodes.seconds[:, None] * shared[AT["gyro_bias"]]
    bias[:, 2] += bias_waves(nodes) @ shared[AT["bias_walk"]]
    return np.asarray(bias + nodes.angle @ shared[AT["gyro_matrix"]].reshape(3, 3).T)


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


def gyro(course: Course, state: State) -> Residuals:
    """Return the residuals of the gyro's rotation between nodes, radians."""
    nodes = course.nodes
    error = gyro_error(nodes, state.shared)
    between = state.attitude[1:] @ np.swapaxes(state.attitude[:-1], 1, 2)
    off = rotation_vectors(between @ np.swapaxes(nodes.turned, 1, 2) @ exp_rotations(-error))
    eye, angle = np.eye(3), nodes.angle[:, None, None]
    by = {
        "gyro_bias": -nodes.seconds[:, None, None] * eye,
        "bias_walk": -bias_waves(nodes)[:, None] * Z[:, None],
        "gyro_matrix": -(eye[:, :, None] * angle).reshape(len(error), 3, 9),
    }
    return Residuals(-off, [(ATTITUDE, -between)], [(ATTITUDE, eye)], by)


def speed(measured: FloatArray, state: State, *, is_ahead: bool) -> Residuals:
    """Return the residuals of the wheels' speed, (n,) in m/s.

    The speed is along the body's x axis if `is_ahead`, else in any direction.
    """
    velocity = state.local[:, VELOCITY]
    if is_ahead:
        known, modelled, by = measured, velocity[:, 0], np.array([1.0, 0.0])
    else:
        known, modelled = np.abs(measured), np.linalg.norm(velocity, axis=1)
        by = (velocity / np.maximum(modelled, 1e-9)[:, None])[:, None]
    residual = np.where(np.isfinite(measured), known - modelled, 0.0)[:, None]
    return Residuals(residual, [(VELOCITY, by)])


def force_at_nodes(course: Course, state: State) -> Residuals:
    """Return the residuals of the specific force at the nodes of a turn without a gyro.

    The force is averaged over the same samples as the field, so that tilting within a node causes
    no error. The velocity of node k is that of the accelerometer between nodes k - 1 and k. The
    last node is left out, because it has no velocity at its end.
    """
    nodes, seconds = course.nodes, course.nodes.seconds[:, None]
    inside, up = nodes.inside[:-1], course.axes[:, 2]
    rate = nodes.rate[:-1] - state.shared[AT["gyro_bias"]]
    axes = np.broadcast_to(course.axes, (len(rate), 3, 3))
    found, _ = acceleration(course, state, axes, rate, np.zeros_like(rate), course.moving[:-1])
    gravity = STANDARD_GRAVITY * state.attitude[:-1, :, 2]
    climb = np.diff(state.local[:, CLIMB], axis=0) / seconds
    predicted = np.einsum("nij,nj->ni", inside, gravity) + climb * up + found.residual
    by_climb = up[:, None] / seconds[:, :, None]
    return Residuals(
        nodes.mean_force[:-1] - predicted,
        [(ATTITUDE, -inside @ skews(gravity)), (CLIMB, -by_climb), *found.node],
        [(CLIMB, by_climb), *found.later],
        found.shared,
    )


def sway(course: Course, state: State) -> Residuals:
    """Return the residuals of the accelerometer's velocity due to the sway of the body, m/s.

    An accelerometer off the pivot moves with every change of tilt: sideways if it is above the
    pivot, along the turn's axis if it is beside the pivot. The velocity of node k, in level axes,
    is that between nodes k - 1 and k.
    """
    shared, attitude, seconds = state.shared, state.attitude, course.nodes.seconds[:, None]
    between = attitude[1:] @ np.swapaxes(attitude[:-1], 1, 2)
    rate = -rotation_vectors(between) / seconds
    height, arm = shared[AT["sway_arm"]][2], course.axes @ shared[AT["sway_arm"]]
    # Of rate x (height up), in level axes.
    across = -course.axes[:, :2].T @ skew(course.axes[:, 2])
    upright, by_upright = _tilted(np.eye(3), shared[AT["upright"]])
    axis = attitude @ upright
    rises = (axis[1:] - axis[:-1]) / seconds
    by_rate = height * across / seconds[:, :, None]
    before, after = (arm @ skews(each) / seconds for each in (axis[:-1], axis[1:]))
    by_arm = np.zeros((len(seconds), 3, 3))
    by_arm[:, :2, 2] = -rate @ across.T
    by_arm[:, 2] = -rises @ course.axes
    by_axis = -arm @ (attitude[1:] - attitude[:-1]) @ by_upright / seconds
    moved = np.column_stack([height * rate @ across.T, rises @ arm])
    local = state.local[1:]
    return Residuals(
        moved - np.column_stack([local[:, VELOCITY], local[:, CLIMB]]),
        [(ATTITUDE, np.concatenate([-by_rate @ between, -before[:, None]], axis=1))],
        [
            (ATTITUDE, np.concatenate([by_rate, after[:, None]], axis=1)),
            (VELOCITY, np.eye(3)[:, :2]),
            (CLIMB, np.eye(3)[:, 2:]),
        ],
        {"sway_arm": by_arm, "upright": Z[:, None] * by_axis[:, None]},
    )


def turning(course: Course, state: State, axes: FloatArray) -> Residuals:
    """Return the residuals of steady rotation about the turn's axis, (n - 1, 1) radians.

    The last column of `axes` is near the turn's axis.
    """
    seconds, rate = course.nodes.seconds[:, None], state.local[:-1, RATE]
    axis, by_axis = _tilted(axes, state.shared[AT["axis"]])
    between = state.attitude[1:] @ np.swapaxes(state.attitude[:-1], 1, 2)
    off = rotation_vectors(between @ exp_rotations(seconds * rate * axis))
    return Residuals(
        -off @ axis[:, None],
        [(ATTITUDE, (-axis @ between)[:, None]), (RATE, seconds[:, :, None])],
        [(ATTITUDE, axis)],
        {"axis": (off @ by_axis)[:, None]},
    )


def lean(state: State, axes: FloatArray, correlation: FloatArray) -> Residuals:
    """Return the residuals of a Gauss-Markov process of the axis' tilt, (n - 1, 2) radians.

    The body turns about an axis fixed in the body and in the world, and sways about this axis.
    """
    axis, by_axis = _tilted(axes, state.shared[AT["axis"]])
    upright, by_upright = _tilted(np.eye(3), state.shared[AT["upright"]])
    across = axes[:, :2].T
    turned = state.attitude @ upright
    leans = (turned - axis) @ across.T
    by_attitude = -across @ skews(turned)
    by_world = across @ state.attitude @ by_upright
    kept = correlation[:, None, None]
    by = {"axis": (kept - 1.0) * (across @ by_axis), "upright": by_world[1:] - kept * by_world[:-1]}
    residual = correlation[:, None] * leans[:-1] - leans[1:]
    node, later = [(ATTITUDE, -kept * by_attitude[:-1])], [(ATTITUDE, by_attitude[1:])]
    return Residuals(residual, node, later, by)


def _tilted(axes: FloatArray, off: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the last axis (3,) tilted by `off` (2,) along the others, and its derivative."""
    vector = axes[:, 2] + axes[:, :2] @ off
    length = np.linalg.norm(vector)
    axis = vector / length
    return axis, (axes[:, :2] - np.outer(axis, axis @ axes[:, :2])) / length
