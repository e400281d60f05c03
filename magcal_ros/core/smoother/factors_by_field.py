"""Factors of a turn without a gyro, in the form of `factors`."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.core.geometry.rotations import exp_rotations, rotation_vectors, skew, skews
from magcal_ros.core.smoother.factors import QUARTER, Residuals
from magcal_ros.core.smoother.state import Course, State
from magcal_ros.core.smoother.unknowns import (
    AT,
    ATTITUDE,
    CLIMB,
    LOCAL,
    RATE,
    SHARED,
    VELOCITY,
)


def force_at_nodes(course: Course, state: State) -> Residuals:
    """Return the residuals of the specific force at the nodes of a turn without a gyro.

    The force is averaged over the same samples as the field, so that tilting within a node causes
    no error. The velocity of node k is that of the accelerometer between nodes k - 1 and k. The
    last node is left out, because it has no velocity at its end.
    """
    nodes, shared = course.nodes, state.shared
    level, up = course.axes[:, :2], course.axes[:, 2]
    inside, rate = nodes.inside[:-1], nodes.rate[:-1]
    turning = (rate @ up)[:, None]
    velocity = state.local[:, VELOCITY]
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    seconds = nodes.seconds[:, None]
    gravity = STANDARD_GRAVITY * state.attitude[:-1, :, 2]
    spin = skews(rate)
    by_arm = spin @ spin
    moving = course.moving[:-1, None]
    acceleration = (velocity[1:] - velocity[:-1]) / seconds + turning * mean @ QUARTER.T
    climb = np.diff(state.local[:, CLIMB])[:, None] / seconds
    predicted = (
        np.einsum("nij,nj->ni", inside, gravity)
        + acceleration @ level.T
        + climb * up
        + by_arm @ shared[AT["lever_arm"]]
        + shared[AT["force_offset"]]
        + moving * shared[AT["force_moving"]]
    )
    count = len(seconds)
    by_node, by_next = np.zeros((count, 3, LOCAL)), np.zeros((count, 3, LOCAL))
    by_node[:, :, ATTITUDE] = -inside @ skews(gravity)
    bend = 0.5 * turning[:, :, None] * (level @ QUARTER)
    by_node[:, :, VELOCITY] = bend - level / seconds[:, :, None]
    by_next[:, :, VELOCITY] = bend + level / seconds[:, :, None]
    by_next[:, :, CLIMB] = up / seconds
    by_node[:, :, CLIMB] = -by_next[:, :, CLIMB]
    by = np.zeros((count, 3, SHARED))
    by[:, :, AT["lever_arm"]] = by_arm
    by[:, :, AT["force_offset"]] = np.eye(3)
    by[:, :, AT["force_moving"]] = moving[:, :, None] * np.eye(3)
    return Residuals(nodes.mean_force[:-1] - predicted, by_node, by_next, by)


def sway(course: Course, state: State) -> Residuals:
    """Return the residuals of the accelerometer's velocity due to the sway of the body, m/s.

    An accelerometer off the pivot moves with every change of tilt: sideways if it is above the
    pivot, along the turn's axis if it is beside the pivot. The velocity of node k, in level axes,
    is that between nodes k - 1 and k.
    """
    shared, attitude, seconds = state.shared, state.attitude, course.nodes.seconds[:, None]
    between = attitude[1:] @ np.swapaxes(attitude[:-1], 1, 2)
    rate = -rotation_vectors(between) / seconds
    height = shared[AT["sway_arm"]][2]
    arm = course.axes @ shared[AT["sway_arm"]]
    # Of rate x (height up), in level axes.
    across = -course.axes[:, :2].T @ skew(course.axes[:, 2])
    upright, by_upright = _tilted(np.eye(3), shared[AT["upright"]])
    axis = attitude @ upright
    rises = (axis[1:] - axis[:-1]) / seconds
    count = len(seconds)
    by_node, by_next = np.zeros((count, 3, LOCAL)), np.zeros((count, 3, LOCAL))
    by_rate = height * across / seconds[:, :, None]
    by_node[:, :2, ATTITUDE] = -by_rate @ between
    by_next[:, :2, ATTITUDE] = by_rate
    by_node[:, 2, ATTITUDE] = -arm @ skews(axis[:-1]) / seconds
    by_next[:, 2, ATTITUDE] = arm @ skews(axis[1:]) / seconds
    moves = [*range(VELOCITY.start, VELOCITY.stop), CLIMB]
    by_next[:, :, moves] = np.eye(3)
    by = np.zeros((count, 3, SHARED))
    by[:, :2, AT["sway_arm"].stop - 1] = -rate @ across.T
    by[:, 2, AT["sway_arm"]] = -rises @ course.axes
    by[:, 2, AT["upright"]] = -arm @ (attitude[1:] - attitude[:-1]) @ by_upright / seconds
    moved = np.column_stack([height * rate @ across.T, rises @ arm])
    return Residuals(moved - state.local[1:, moves], by_node, by_next, by)


def turning(course: Course, state: State, axes: FloatArray) -> Residuals:
    """Return the residuals of steady rotation about the turn's axis, (n - 1, 1) radians.

    The last column of `axes` is near the turn's axis.
    """
    seconds, rate = course.nodes.seconds[:, None], state.local[:-1, RATE]
    axis, by_axis = _tilted(axes, state.shared[AT["axis"]])
    between = state.attitude[1:] @ np.swapaxes(state.attitude[:-1], 1, 2)
    off = rotation_vectors(between @ exp_rotations(seconds * rate * axis))
    count = len(seconds)
    by_node, by_next = np.zeros((count, 1, LOCAL)), np.zeros((count, 1, LOCAL))
    by_node[:, 0, ATTITUDE] = -axis @ between
    by_next[:, 0, ATTITUDE] = axis
    by_node[:, :, RATE] = seconds[:, :, None]
    by = np.zeros((count, 1, SHARED))
    by[:, 0, AT["axis"]] = off @ by_axis
    return Residuals(-off @ axis[:, None], by_node, by_next, by)


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
    by = np.zeros((len(leans), 2, SHARED))
    by[:, :, AT["axis"]] = -across @ by_axis
    by[:, :, AT["upright"]] = across @ state.attitude @ by_upright
    count, kept = len(correlation), correlation[:, None, None]
    by_node, by_next = np.zeros((count, 2, LOCAL)), np.zeros((count, 2, LOCAL))
    by_node[:, :, ATTITUDE] = -kept * by_attitude[:-1]
    by_next[:, :, ATTITUDE] = by_attitude[1:]
    residual = correlation[:, None] * leans[:-1] - leans[1:]
    return Residuals(residual, by_node, by_next, by[1:] - kept * by[:-1])


def _tilted(axes: FloatArray, off: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the last axis (3,) tilted by `off` (2,) along the others, and its derivative."""
    vector = axes[:, 2] + axes[:, :2] @ off
    length = np.linalg.norm(vector)
    axis = vector / length
    return axis, (axes[:, :2] - np.outer(axis, axis @ axes[:, :2])) / length
