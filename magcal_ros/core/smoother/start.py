"""Initial values: from a linear fit; without a gyro, every geometric solution."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray, accumulated
from magcal_ros.core.geometry.attitude import mean_angle, unit
from magcal_ros.core.geometry.rotations import (
    chained,
    minimal_rotation,
    roll_pitch_between,
    rotation_about,
    rotation_from_rpy,
)
from magcal_ros.core.geometry.shapes import fit_circle_robustly, plane_normal
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.smoother.factors import Z, motor_inputs
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.priors import Priors
from magcal_ros.core.smoother.state import Course, State, level_axes
from magcal_ros.core.smoother.unknowns import (
    AT,
    EARTH,
    LOCAL,
    MICROTESLA,
    MOTORS,
    RATE,
    ROLL_PITCH,
    SHIELDING,
    USUALLY_LATE,
)

BIASES = (0.0, 0.01, -0.01, 0.025, -0.025, 0.05, -0.05, 0.1, -0.1)
"""Tried values of the gyro's bias about up, rad/s."""
UP_SECONDS = 4.0  # seconds over which up is averaged
LARGEST_MOTORS = 20.0
"""Prior sigma of the motors' field at the start, over the usual residual of a node."""
PIECE_SECONDS = 100.0  # seconds in which the yaw by the gyro drifts too little to harm the start


def start(nodes: Nodes, priors: Priors) -> tuple[State, Priors]:
    """Return an initial state, and the priors about it.

    With the rotation R from level axes, the field is linear in the unknowns: `m = R c + h + k u +
    l w`. They are the Earth's field c, the hard iron h, and the motors' field k in motion (u) and l
    per turn rate (w). A current adds a term of the same form. Installation and soft iron start at
    zero.
    """
    up, level, yaw = _in_first_axes(nodes)
    run = np.concatenate([[0], np.cumsum(~nodes.is_tied)])
    longest = run == np.bincount(run).argmax()
    piece = _pieces(nodes.time[longest])
    largest, node_weight = 1.0, np.ones(len(nodes))
    if nodes.currents is not None:
        largest, unknown = nodes.currents.battery.largest, nodes.currents.variance(USUALLY_LATE)
        node_weight = 1.0 / (1.0 + unknown * (LARGEST_MOTORS / largest) ** 2 / 3.0)
    axes, along = level_axes(np.median(up, axis=0)), np.median(up, axis=0)

    def tried(bias: float) -> tuple[float, float, FloatArray, FloatArray]:
        course = Course.of(nodes, axes, bias * along, priors.lengths)
        motors = np.hstack(list(motor_inputs(course, priors.mean).values()))
        motors[:, 2:] /= largest
        turned = level @ rotation_about(Z, -(yaw - bias * (nodes.time - nodes.time[0])))
        rows = nodes.field[longest], turned[longest], motors[longest], piece, node_weight[longest]
        found, drifted, misfit = _linear(*rows, -float(priors.mean[EARTH][1]))
        turned[longest] = turned[longest] @ rotation_about(Z, drifted)
        return misfit * (1.0 + 2.0 * abs(bias)), bias, turned, found

    _, bias, turned, found = min(map(tried, BIASES), key=lambda each: each[0])
    for each in np.unique(run[~longest]):
        turned[run == each] = _aligned(turned, nodes.field, found, run == each)
    north = rotation_about(Z, np.array([math.atan2(found[0], found[1])]))[0]
    shared = priors.mean.copy()
    shared[AT["iron"]] = found[3:6]
    if priors.scale[AT["motors_moving"]].any():
        for name, field in zip(MOTORS, found[6:].reshape(-1, 3), strict=False):
            shared[AT[name]] = field / (largest if name == "motors_current" else 1.0)
    shared[AT["gyro_bias"]] = bias * along
    about = priors.about(found[3:6], axes)
    shared[AT["mounting_yaw"]] = about.mean[AT["mounting_yaw"]]
    shared[EARTH] = priors.fields.at_level(math.hypot(found[0], found[1]))
    return State(turned @ north.T, np.zeros((len(nodes), LOCAL)), shared), about


def _in_first_axes(nodes: Nodes) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return up in body axes (n, 3), level axes (n, 3, 3), and the yaw (n,) by the gyro alone."""
    up = _up(nodes, chained(nodes.turned[None])[0])
    spin = np.sum(nodes.rate * up, axis=1)
    steps = np.where(nodes.is_tied, 0.5 * (spin[1:] + spin[:-1]) * nodes.seconds, 0.0)
    return up, level_axes(up), accumulated(steps)


def _aligned(
    turned: FloatArray, field: FloatArray, found: FloatArray, rows: BoolArray
) -> FloatArray:
    """Return the axes of nodes without a gyro link, turned about up to match the field.

    `found` begins with the Earth's field in the other nodes' axes and the hard iron.
    """
    seen = np.einsum("nji,nj->ni", turned[rows], field[rows] - found[3:6])
    apart = np.arctan2(seen[:, 1], seen[:, 0]) - math.atan2(found[1], found[0])
    return np.asarray(turned[rows] @ rotation_about(Z, np.array([mean_angle(apart)]))[0])


def _up(nodes: Nodes, path: FloatArray) -> FloatArray:
    """Return up at each node: the force, averaged in axes stabilised by the gyro."""
    force = np.vstack(
        [nodes.force[:1], 0.5 * (nodes.force[1:] + nodes.force[:-1]), nodes.force[-1:]]
    )
    worth = np.concatenate(
        [nodes.samples[:1], np.minimum(nodes.samples[1:], nodes.samples[:-1]), nodes.samples[-1:]]
    )
    held = np.einsum("nji,nj->ni", path, force)
    apart = (nodes.time[:, None] - nodes.time) / UP_SECONDS
    kernel = np.exp(-0.5 * apart**2) * np.maximum(worth, 1e-3)
    return unit(np.einsum("nij,nj->ni", path, kernel @ held))


def _pieces(time: FloatArray) -> IntArray:
    """Return the piece of the drive, about `PIECE_SECONDS` long, that each node is in, from 0."""
    count = max(1, round(float(np.ptp(time)) / PIECE_SECONDS))
    piece = np.floor((time - time[0]) * count / max(float(np.ptp(time)), 1e-9))
    return np.asarray(np.unique(np.minimum(piece, count - 1), return_inverse=True)[1])


def _linear(
    field: FloatArray,
    turned: FloatArray,
    motors: FloatArray,
    piece: IntArray,
    node_weight: FloatArray,
    upward: float,
) -> tuple[FloatArray, FloatArray, float]:
    """Return c, h, k and l, fitted by reweighted least squares, the yaw's drift, and the residual.

    The level part of c has a separate direction in each `piece` (n,); that of the first piece is
    returned. `node_weight` (n,) is lower where the current is uncertain. The drift of the yaw (n,)
    is since the first piece, radians. The residual is the median, µT.
    """
    count, pieces = len(field), int(piece[-1]) + 1
    eye = np.broadcast_to(np.eye(3), (count, 3, 3))
    by_motors = [each[:, None, None] * eye for each in motors.T]
    level = (piece[:, None] == np.arange(pieces))[:, None, :, None] * turned[:, :, None, :2]
    level = level.reshape(count, 3, 2 * pieces)
    rows = np.concatenate([level, turned[:, :, 2:], eye, *by_motors], axis=2)
    unknowns = rows.shape[2]
    count_motors = 3 * motors.shape[1]
    known = np.zeros((1 + count_motors, unknowns))
    known[0, 2 * pieces] = 1.0 / 3.0
    known[1:, -count_motors:] = np.eye(count_motors) / LARGEST_MOTORS
    expected = np.append(upward / 3.0, np.zeros(count_motors))
    weight = node_weight
    for _ in range(12):
        scale = np.repeat(np.sqrt(weight), 3)
        left = np.vstack([rows.reshape(-1, unknowns) * scale[:, None], known])
        right = np.append(field.ravel() * scale, expected)
        found = np.linalg.lstsq(left, right, rcond=None)[0]
        misfit = np.linalg.norm(field - rows @ found, axis=1)
        middle = float(np.median(misfit))
        weight = node_weight / (1.0 + (misfit / (1.5 * middle + 1e-9)) ** 2)
    earth = found[: 2 * pieces].reshape(pieces, 2)
    angle = np.unwrap(np.arctan2(earth[:, 1], earth[:, 0]))
    first = unit(earth[0]) * float(np.linalg.norm(earth, axis=1).mean())
    middles = [float(np.median(np.flatnonzero(piece == k))) for k in range(pieces)]
    drift = np.interp(np.arange(count), middles, angle - angle[0])
    return np.append(first, found[2 * pieces :]), drift, middle


CONE_RATIO = 4.0
"""Least ratio of the variances within and across a visible circle of up vectors."""
THINNEST_CONE = 0.005
"""Least standard deviation across the circle, of unit vectors."""
DIP = math.radians(60.0)  # dip that is tried if neither the field's strength nor its dip is known


def starts_by_field(
    nodes: Nodes, up: FloatArray, priors: Priors, reference: ReferenceField
) -> list[tuple[Nodes, State, Priors]]:
    """Return every geometric solution for axis, circle and dip, in no particular order.

    The nodes are those of a turn without a gyro, and `up` (n, 3) are unit vectors in body axes.
    Returned are the nodes in axes in which the robot turns about the axis of the solution, the
    state, and the priors about it.
    """
    strength, inclination = (
        math.nan if each.is_unknown else each.value * unit_
        for each, unit_ in ((reference.strength, MICROTESLA), (reference.inclination, 1.0))
    )
    circle, found = fit_circle_robustly(nodes.field), []
    for axis in _axes(up):
        normal = circle.normal * math.copysign(1.0, float(circle.normal @ axis))
        height = float(circle.centre @ normal)
        for tilt in roll_pitch_between(axis, normal, or_nearest=True):
            turned = _turned(axis, (nodes.field - circle.centre) @ rotation_from_rpy(*tilt).T)
            shown = unit(np.einsum("nji,nj->i", turned, up))
            for angle in _elevations(shown, circle.radius, height, strength, inclination):
                level = math.cos(angle)
                if level > 0.02:
                    size = circle.radius / max(level, 0.05) if math.isnan(strength) else strength
                    above = size * np.array([level, 0.0, math.sin(angle)])
                    iron = circle.centre - above[2] * normal
                    found.append(_Solution(turned, shown, above, iron, tilt))
    if math.isfinite(strength + inclination):
        found.extend(_without_installation(nodes.field, up, strength, inclination))
    return [each.start(nodes, priors, strength, inclination) for each in found]


def _axes(up: FloatArray) -> list[FloatArray]:
    """Return candidates for the turn's axis in body axes: mean of up, and normal of its circle."""
    mean = unit(up.mean(axis=0))
    normal, variances = plane_normal(up)
    if variances[1] < CONE_RATIO * max(variances[0], THINNEST_CONE**2):
        return [mean]
    return [mean, normal * math.copysign(1.0, float(normal @ mean))]


def _turned(axis: FloatArray, field: FloatArray) -> FloatArray:
    """Return rotations (n, 3, 3) to body axes from a frame that turns about an axis.

    Its z is the axis (3,), and the field (n, 3) is above its x.
    """
    to_body = minimal_rotation(Z, axis)
    level = field @ to_body
    return np.asarray(to_body @ rotation_about(Z, np.arctan2(level[:, 1], level[:, 0])))


def _elevations(
    up: FloatArray, radius: float, height: float, strength: float, inclination: float
) -> tuple[float, ...]:
    """Return possible angles of the field over the turn's plane, radians.

    `up` is in the frame of the turn, `radius` and `height` (along the axis, hard iron included) are
    those of the field's circle, µT. Strength and inclination are NaN if they are not known.
    """
    if math.isfinite(inclination):
        reach, phase = math.hypot(up[0], up[2]), math.atan2(up[2], up[0])
        ratio = -math.sin(inclination) / max(reach, 1e-9)
        opening = math.acos(min(1.0, max(-1.0, ratio)))
        return phase + opening, phase - opening
    if math.isfinite(strength):
        opening = math.acos(min(1.0, radius / strength))
        return -opening, opening
    return -DIP, math.atan2(height, radius), DIP


def _without_installation(
    field: FloatArray, up: FloatArray, strength: float, inclination: float
) -> Iterator[_Solution]:
    """Yield the solution without installation error, as far as it is determined.

    `m.u = c + h.u` and `|m|^2 = 2 m.h + k` are linear in h. It needs no circle, so that it also
    works if a turn wobbles too much for one.
    """
    n, size = len(field), 2.0 * strength
    rows = np.block(
        [
            [up, np.zeros((n, 1))],
            [2.0 * field / size, np.full((n, 1), 1.0 / size)],
            [1e-3 * math.sqrt(n) * np.eye(3), np.zeros((3, 1))],
        ]
    )
    along = np.sum(field * up, axis=1) + strength * math.sin(inclination)
    right = np.concatenate([along, np.sum(field**2, axis=1) / size, np.zeros(3)])
    iron = np.linalg.lstsq(rows, right, rcond=None)[0][:3]
    turned = _turned(unit(up.mean(axis=0)), field - iron)
    shown = unit(np.einsum("nji,nj->i", turned, up))
    above = np.einsum("nji,nj->i", turned, field - iron) / n
    if np.linalg.norm(np.cross(shown, above)) >= 1e-6 * strength:
        yield _Solution(turned, shown, above, iron, (0.0, 0.0))


class _Solution(NamedTuple):
    """A geometric solution for axis, circle and dip."""

    turned: FloatArray  # from the frame of the turn, z along its axis, to body axes. (n, 3, 3).
    up: FloatArray  # in that frame. Shape (3,).
    field: FloatArray  # of the Earth there, µT. Shape (3,).
    iron: FloatArray  # hard iron, µT. Shape (3,).
    installation: tuple[float, float]  # roll and pitch, radians

    def start(
        self, nodes: Nodes, priors: Priors, strength: float, inclination: float
    ) -> tuple[Nodes, State, Priors]:
        """Return the start; strength and inclination are NaN if they are not known."""
        assert nodes.tied_to is not None
        east = unit(np.cross(self.field, self.up))
        attitude = self.turned @ np.stack([east, np.cross(self.up, east), self.up]).T
        seen = float(np.linalg.norm(self.field))
        sine = -float(self.up @ self.field) / max(seen, 1e-12)
        size = seen if math.isnan(strength) else strength
        dip = math.asin(min(1.0, max(-1.0, sine))) if math.isnan(inclination) else inclination
        shared, local = priors.mean.copy(), np.zeros((len(nodes), LOCAL))
        shared[AT["iron"]], shared[ROLL_PITCH] = self.iron, self.installation
        shared[EARTH] = size * np.array([math.cos(dip), math.sin(dip)])
        local[:, RATE] = nodes.rate @ nodes.tied_to[:, 2:]
        state = State(attitude, local, shared)
        if priors.scale[SHIELDING] > 0.0:
            shared[SHIELDING] = _gain(nodes.field, attitude @ state.earth) - 1.0
        # The installation tilts the axis that the field shows.
        turning = nodes.in_axes(minimal_rotation(nodes.tied_to[:, 2], self.turned[0, :, 2]))
        axes = level_axes(np.median(attitude[:, :, 2], axis=0))
        return turning, state, priors.about(self.iron, axes)


def _gain(field: FloatArray, expected: FloatArray) -> float:
    """Return the ratio of the varying parts of a field (n, 3) and of the expected one.

    A steel body may weaken the field to a fifth.
    """
    turns, seen = expected - expected.mean(axis=0), field - field.mean(axis=0)
    return max(float(np.sum(turns * seen) / np.sum(turns**2)), 0.2)
