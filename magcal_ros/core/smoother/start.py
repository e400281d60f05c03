"""Where the iterations begin: attitudes by gyro and gravity, hard iron by a linear fit."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.rotations import chained, rotation_about
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.rests import Course, level_axes
from magcal_ros.core.smoother.state import State
from magcal_ros.core.smoother.unknowns import AT, EARTH, LOCAL, SHARED, Priors

BIASES = (0.0, 0.01, -0.01, 0.025, -0.025, 0.05, -0.05, 0.1, -0.1)
"""rad/s about up of the gyro's bias that are tried."""
SMOOTHED = 4.0
"""Seconds over which up is averaged."""
MOTORS = 20.0
"""µT of the motors' field, over the usual misfit of a node in µT: what the start allows for."""
Z = np.array([0.0, 0.0, 1.0])


def start(nodes: Nodes, priors: Priors, biases: tuple[float, ...] = BIASES) -> tuple[State, Priors]:
    """Return a start, and the priors about it.

    Turned to level axes, the field is `m = R c + h + k u + l w` with one vector c of the Earth's
    field, one h of hard iron, and the motors' k while the robot moves (u) and l per turn rate (w),
    which is linear. Installation and soft iron begin at zero.
    """
    path = chained(nodes.turned[None])[0]
    up = _up(nodes, path)
    spin = np.sum(nodes.rate * up, axis=1)
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (spin[1:] + spin[:-1]) * nodes.seconds)])
    level = level_axes(up)
    best: tuple[float, float, FloatArray, FloatArray] | None = None
    axes, along = level_axes(np.median(up, axis=0)), np.median(up, axis=0)
    for bias in biases:
        course = Course.of(nodes, axes, bias * along, priors.lengths)
        motors = np.stack([course.moving, nodes.rate[:, 2]], axis=1)
        turned = level @ rotation_about(Z, -(yaw - bias * (nodes.time - nodes.time[0])))
        found, misfit = _linear(nodes, turned, motors, -float(priors.mean[EARTH][1]))
        score = misfit * (1.0 + 2.0 * abs(bias))
        if best is None or score < best[0]:
            best = score, bias, turned, found
    assert best is not None
    _, bias, turned, found = best
    north = rotation_about(Z, np.array([math.atan2(found[0], found[1])]))[0]
    shared = priors.mean.copy()
    shared[AT["iron"]] = found[3:6]
    if priors.scale[AT["motors_moving"]].any():
        shared[AT["motors_moving"]], shared[AT["motors_rate"]] = found[6:9], found[9:]
    shared[AT["gyro_bias"]] = bias * along
    strength = math.hypot(found[0], found[1])
    about = priors.about(found[3:6], strength)
    shared[EARTH] = about.mean[EARTH]
    assert shared.shape == (SHARED,)
    return State(turned @ north.T, np.zeros((len(nodes), LOCAL)), shared), about


def _up(nodes: Nodes, path: FloatArray) -> FloatArray:
    """Return up at each node: the force, averaged in axes that the gyro holds still."""
    force = np.vstack(
        [nodes.force[:1], 0.5 * (nodes.force[1:] + nodes.force[:-1]), nodes.force[-1:]]
    )
    worth = np.concatenate(
        [nodes.samples[:1], np.minimum(nodes.samples[1:], nodes.samples[:-1]), nodes.samples[-1:]]
    )
    held = np.einsum("nji,nj->ni", path, force)
    apart = (nodes.time[:, None] - nodes.time) / SMOOTHED
    kernel = np.exp(-0.5 * apart**2) * np.maximum(worth, 1e-3)
    return unit(np.einsum("nij,nj->ni", path, kernel @ held))


def _linear(
    nodes: Nodes, turned: FloatArray, motors: FloatArray, upward: float
) -> tuple[FloatArray, float]:
    """Return c, h, k and l by iterated weighted least squares, and the median misfit, µT."""
    count = len(nodes)
    eye = np.broadcast_to(np.eye(3), (count, 3, 3))
    by_motors = [each[:, None, None] * eye for each in motors.T]
    rows = np.concatenate([turned, eye, *by_motors], axis=2)
    known = np.vstack([np.eye(12)[2] / 3.0, np.diag([0.0] * 6 + [1.0 / MOTORS] * 6)[6:]])
    expected = np.append(upward / 3.0, np.zeros(6))
    weight = np.ones(count)
    for _ in range(12):
        scale = np.repeat(np.sqrt(weight), 3)
        left = np.vstack([rows.reshape(-1, 12) * scale[:, None], known])
        right = np.append(nodes.field.ravel() * scale, expected)
        found = np.linalg.lstsq(left, right, rcond=None)[0]
        misfit = np.linalg.norm(nodes.field - rows @ found, axis=1)
        middle = float(np.median(misfit))
        weight = 1.0 / (1.0 + (misfit / (1.5 * middle + 1e-9)) ** 2)
    return found, middle
