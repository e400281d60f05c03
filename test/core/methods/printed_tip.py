"""The design tip DT0103 as printed (the scan's gaps repaired), traps included, for comparison.

North-east-down, gravity reading +1 downwards, gravity = field strength = 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


class EndlessLoop(Exception):
    """The printed Newton search would never return."""


@dataclass(frozen=True)
class Turn:
    gravity: np.ndarray
    field: np.ndarray
    installation: np.ndarray
    hard_iron: np.ndarray
    gains: np.ndarray
    dip: float


@dataclass(frozen=True)
class Answer:
    rotation: np.ndarray
    hard_iron: np.ndarray
    axis: np.ndarray


def passive(roll, pitch, yaw=0.0):
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    about_x = np.array([[1, 0, 0], [0, cr, sr], [0, -sr, cr]])
    about_y = np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]])
    about_z = np.array([[cy, sy, 0], [-sy, cy, 0], [0, 0, 1]])
    return about_x @ about_y @ about_z


def about(axis, angles):
    x, y, z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    cross = np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])
    return np.array(
        [np.eye(3) + np.sin(a) * cross + (1 - np.cos(a)) * cross @ cross for a in angles]
    )


def simulate(
    axis=(0, 0.9, 0.9),
    installation_deg=(20.0, 30.0),
    hard_iron=(0.1, -0.2, 0.3),
    gains=(0.5, 1.2, 0.9),
    dip_deg=60.0,
    samples=50,
    arc_deg=315.0,
    start_deg=(0.0, 0.0, 0.0),
    noise=0.0,
    seed=0,
):
    rng = np.random.default_rng(seed)
    attitude = about(axis, np.radians(np.linspace(0.0, arc_deg, samples))) @ passive(
        *np.radians(start_deg)
    )
    dip = np.radians(dip_deg)
    installation = passive(*np.radians(installation_deg))
    gravity = attitude @ [0.0, 0.0, 1.0]
    body_field = attitude @ [np.cos(dip), 0.0, np.sin(dip)]
    field = body_field @ installation.T * gains + hard_iron
    return Turn(
        gravity + noise * rng.standard_normal(gravity.shape),
        field + noise * rng.standard_normal(field.shape),
        installation,
        np.asarray(hard_iron),
        np.asarray(gains),
        dip,
    )


def normal_least_squares(points):
    scatter = np.cov(points.T, bias=True)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = scatter
    minors = np.array([yy * zz - yz**2, xx * zz - xz**2, xx * yy - xy**2])
    main = int(np.argmax(np.abs(minors)))
    if minors[main] == 0.0:
        return np.zeros(3)
    normal = [
        [minors[0], xz * yz - xy * zz, xy * yz - xz * yy],
        [yz * xz - xy * zz, minors[1], xy * xz - yz * xx],
        [yz * xy - xz * yy, xz * xy - yz * xx, minors[2]],
    ][main]
    return normal / np.linalg.norm(normal)


def normal_eigen(points, eigen=np.linalg.eigh):
    """Take the first eigenvector, in whatever order `eigen` returns them."""
    centred = points - points.mean(axis=0)
    return eigen(centred.T @ centred)[1][:, 0]


def centre_rotated(points):
    x, y = points.T
    a, b, c, d, e = _solve([x * x, y * y, 2 * x * y, 2 * x, 2 * y])
    return -np.linalg.solve([[a, c], [c, b]], [d, e])


def centre_aligned(points):
    x, y = points.T
    a, b, c, d = _solve([x * x, y * y, 2 * x, 2 * y])
    return np.array([-c / a, -d / b])


def centre_circle(points):
    x, y = points.T
    a, b, c = _solve([x * x + y * y, 2 * x, 2 * y])
    return np.array([-b / a, -c / a])


def centre_robust(points):
    mean = points.mean(axis=0)
    x, y = (points - mean).T
    quadratic, linear = np.column_stack([x * x, x * y, y * y]), np.column_stack([x, y, x**0])
    to_linear = -np.linalg.inv(linear.T @ linear) @ (linear.T @ quadratic)
    m = quadratic.T @ quadratic + quadratic.T @ linear @ to_linear
    vectors = np.linalg.eig(np.array([m[2] / 2, -m[1], m[0] / 2]))[1]
    (chosen,) = np.flatnonzero(4 * vectors[0] * vectors[2] - vectors[1] ** 2 > 0)
    a, b, c = vectors[:, chosen].real
    d, e, _ = to_linear @ [a, b, c]
    return mean - np.linalg.solve([[2 * a, b], [b, 2 * c]], [d, e])


def _solve(columns):
    design = np.column_stack(columns)
    return np.linalg.solve(design.T @ design, design.T @ np.ones(len(design)))


def roll_pitch_of(normal):
    x, y, z = normal
    roll = np.arctan2(y, z)
    return roll, np.arctan(-x / (y * np.sin(roll) + z * np.cos(roll)))


def newton(field_rotation, axis_rotation):
    """Search the yaw that makes the installation's own yaw vanish."""
    m, a = field_rotation[0], axis_rotation
    even, odd, rest = (
        a[:, 0] * m[0] + a[:, 1] * m[1],
        a[:, 1] * m[0] - a[:, 0] * m[1],
        a[:, 2] * m[2],
    )
    y, iteration = 0.0, 1
    for _ in range(1000):
        y = np.mod(y, 2 * np.pi)
        y = y - 2 * np.pi if y > np.pi else y
        row = np.cos(y) * even - np.sin(y) * odd + rest
        slope = -np.sin(y) * even[1] - np.cos(y) * odd[1]
        if abs(slope) < 1e-2:
            y += np.pi / 2
            continue
        better = y - row[1] / slope
        done = abs(y - better) < 1e-6
        if done and row[0] * np.cos(np.arcsin(np.clip(row[2], -1, 1))) < 0:
            y += np.pi
            continue
        y, iteration = better, iteration + 1
        if done or iteration > 20:
            return y
    raise EndlessLoop


def run(turn, normal=normal_least_squares, centre=centre_rotated, noise=0.0):
    """Follow the main script; `noise` is the RMS for its cluster test."""
    mean = turn.gravity.mean(axis=0)
    spread = np.linalg.norm(turn.gravity - mean, axis=1).mean()
    axis = _upwards_in_ned(normal(turn.gravity))
    if spread <= 6 * noise:
        axis = np.array([0.0, 0.0, 1.0])
    axis_rotation = passive(*roll_pitch_of(axis))
    field_rotation = passive(*roll_pitch_of(_upwards_in_ned(normal(turn.field)) * turn.gains))
    flat = turn.field / turn.gains @ field_rotation
    reference = axis_rotation.T @ [np.cos(turn.dip), 0.0, np.sin(turn.dip)]
    middle = np.append(centre(flat[:, :2]), flat[:, 2].mean() - reference[2])
    yaw = newton(field_rotation, axis_rotation)
    rotation = field_rotation @ passive(0.0, 0.0, -yaw) @ axis_rotation.T
    return Answer(rotation, field_rotation @ middle * turn.gains, axis)


def _upwards_in_ned(normal):
    return -normal if normal[2] < 0 else normal


NORMALS = {
    "least_squares": normal_least_squares,
    "eigen": normal_eigen,
    "eigen_simple": normal_eigen,
}
CENTRES = {
    "circle": centre_circle,
    "ellipse": centre_aligned,
    "rotated_ellipse": centre_rotated,
    "halir_flusser": centre_robust,
}


def heading_error_deg(turn, answer):
    """RMS over 24 headings x 9 tilts of the yaw that a calibration gives."""
    tilts = np.radians([-10.0, 0.0, 10.0])
    errors = []
    for yaw in np.arange(24) * np.pi / 12:
        for roll in tilts:
            for pitch in tilts:
                field = passive(roll, pitch, yaw) @ [np.cos(turn.dip), 0.0, np.sin(turn.dip)]
                raw = turn.installation @ field * turn.gains + turn.hard_iron
                seen = answer.rotation.T @ ((raw - answer.hard_iron) / turn.gains)
                level = passive(roll, pitch).T @ seen
                errors.append(np.arctan2(-level[1], level[0]) - yaw)
    return float(np.degrees(np.sqrt(np.mean(np.angle(np.exp(1j * np.array(errors))) ** 2))))
