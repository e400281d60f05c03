"""Factors: residuals of the measurements, and derivatives with respect to the unknowns.

A residual is the measurement minus its prediction; the derivatives are those of the prediction.
Attitudes are perturbed on the body's side, R <- exp(phi) R.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, wrap_angle
from magcal_ros.core.geometry.rotations import (
    crossed,
    exp_rotations,
    rotation_from_rpy,
    skew,
    skews,
)
from magcal_ros.core.smoother.places import Places
from magcal_ros.core.smoother.state import Course, State
from magcal_ros.core.smoother.unknowns import (
    AT,
    ATTITUDE,
    BIAS_UP,
    BODY_FIELD,
    CURRENT_LATE,
    HEADING_DRIFT,
    LOCAL,
    ROLL_PITCH,
    SHARED,
    SHIELDING,
    STREET,
    TURNED,
    YAW,
)


def _element_matrices() -> FloatArray:
    """Return the derivative of the soft iron by each of its parameters, shape (6, 3, 3)."""
    out, each = np.zeros((6, 3, 3)), np.arange(6)
    rows, columns = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
    out[each, rows, columns] = out[each, columns, rows] = 1.0
    return out


ELEMENT_MATRICES = _element_matrices()
LEVEL = np.diag([1.0, 1.0, 0.0])  # derivative of the soft iron by the shielding
X, Y, Z = np.eye(3)
LEVEL_AXES, UP_AXIS = slice(0, 2), slice(2, 3)  # components of a residual in body axes


Blocks = Sequence[tuple[slice, FloatArray]]
"""Derivatives by some unknowns of a node; each of shape (k, d, width), or one for all k."""
CENTRES = "centres"  # the name of the centres of `Places` among the groups of shared unknowns


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of one kind with their derivatives, of which most are zero."""

    residual: FloatArray  # Shape (k, d)
    node: Blocks  # derivatives by the unknowns of node k
    later: Blocks = ()  # by the unknowns of node k + 1, for residuals between neighbours
    shared: Mapping[str, FloatArray] = field(default_factory=dict)
    """By groups of shared unknowns (`AT` and `CENTRES`); shapes as in `Blocks`."""

    @property
    def local(self) -> tuple[int, int]:
        """The first of a node's unknowns on which the residuals depend, and the end."""
        columns = [columns for columns, _ in (*self.node, *self.later)]
        return min(each.start for each in columns), max(each.stop for each in columns)

    def part(self, components: slice) -> Residuals:
        """Return some components of the residuals."""
        return self._changed(lambda block: block[..., components, :])

    def times(self, matrices: FloatArray) -> Residuals:
        """Return the residuals, each multiplied by its matrix, shape (k, d, d)."""
        return self._changed(lambda block: matrices @ block)

    def _changed(self, change: Callable[[FloatArray], FloatArray]) -> Residuals:
        node, later = (
            [(columns, change(block)) for columns, block in blocks]
            for blocks in (self.node, self.later)
        )
        shared = {name: change(block) for name, block in self.shared.items()}
        return Residuals(change(self.residual[:, :, None])[:, :, 0], node, later, shared)

    @property
    def by_node(self) -> FloatArray:
        """Derivatives by the unknowns of node k, shape (k, d, LOCAL)."""
        out = np.zeros((*self.residual.shape, LOCAL))
        put(out, self.node)
        return out

    def by(self, free: IntArray) -> FloatArray:
        """Return the derivatives by the free shared unknowns, shape (k, d, s)."""
        out = np.zeros((*self.residual.shape, len(free)))
        self.put_shared(out, free)
        return out

    def put_shared(self, out: FloatArray, free: IntArray) -> None:
        """Write the derivatives by the free shared unknowns into zeros (k, d, s)."""
        columns = _columns(free.tobytes())
        for name, block in self.shared.items():
            rows, own = columns[name]
            out[:, :, rows] = block[..., own]


def put(out: FloatArray, blocks: Blocks, first: int = 0) -> None:
    """Write blocks into zeros (k, d, n), whose first column is that of an unknown of a node."""
    for columns, block in blocks:
        out[:, :, columns.start - first : columns.stop - first] = block


@lru_cache(maxsize=64)
def _columns(free: bytes) -> dict[str, tuple[slice, IntArray]]:
    """Return where the free unknowns of each group are among all free ones, and in the group."""
    indices, found = np.frombuffer(free, dtype=np.intp), {}
    for name, at in {**AT, CENTRES: slice(SHARED, None)}.items():
        first = np.searchsorted(indices, at.start)
        end = None if at.stop is None else np.searchsorted(indices, at.stop)
        found[name] = slice(first, end), indices[first:end] - at.start
    return found


def installation(shared: FloatArray) -> FloatArray:
    """Return the rotation from body axes to the magnetometer's, shape (3, 3)."""
    roll, pitch = shared[ROLL_PITCH]
    return rotation_from_rpy(roll, pitch, shared[YAW] + shared[TURNED]).T


def soft_iron(shared: FloatArray) -> FloatArray:
    """Return I + E, shape (3, 3)."""
    own = np.eye(3) + np.tensordot(shared[AT["soft_iron"]], ELEMENT_MATRICES, 1)
    return np.asarray(own + shared[SHIELDING] * LEVEL)


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
    nodes, shared, count = course.nodes, state.shared, len(course.nodes)
    angle, rate = nodes.turned_since(shared[AT["latency"]][0])
    late = exp_rotations(angle)
    attitude = late @ state.attitude
    ahead, gradient = state.attitude[:, 0, :2], shared[AT["gradient"]].reshape(3, 2)
    # Of a node in which iron is added, half is expected to be after that.
    present = np.heaviside(nodes.time - nodes.added_from, 0.5)
    comes = present == 0.5
    added = (present + comes * shared[AT["came"]])[:, None]
    span = (nodes.time - nodes.time.mean()) / max(np.ptp(nodes.time), 1e-9)
    disturbance = places.disturbance(state) + ahead @ gradient.T
    disturbance += shared[AT["place"]] + added * shared[AT["entered"]]
    earth, street = attitude @ state.earth, np.einsum("nij,nj->ni", attitude, disturbance)
    turn, bend = installation(shared), soft_iron(shared)
    by_earth, by_street = bend @ turn @ nodes.inside, turn @ nodes.inside
    by_place = by_street @ attitude
    turned, turned_street = (np.einsum("nij,nj->ni", by_street, each) for each in (earth, street))
    of_the_body = {"iron": np.ones((count, 1)), **motor_inputs(course, shared)}
    of_the_body |= {"drift": span[:, None], "added": added}
    predicted = turned @ bend.T + turned_street + state.local[:, BODY_FIELD]
    predicted += sum(share * shared[AT[name]] for name, share in of_the_body.items())
    swung = np.swapaxes(state.attitude, 1, 2)[:, :2] @ skew(X)
    by_attitude = by_place @ gradient @ swung
    by_attitude -= (by_earth @ skews(earth) + by_street @ skews(street)) @ late
    axes = [crossed(turned, e) @ bend.T + crossed(turned_street, e) for e in _turning(shared)]
    delayed = np.einsum("nij,nj->ni", by_earth, crossed(rate, earth))
    delayed += np.einsum("nij,nj->ni", by_street, crossed(rate, street))
    step = shared[AT["added"]] + by_place @ shared[AT["entered"]]
    centres = np.einsum("nk,nij->nikj", places.weights, by_place)
    by = {
        **{name: share[:, :, None] * np.eye(3) for name, share in of_the_body.items()},
        "earth": (by_earth @ attitude)[:, :, 1:] * [1.0, -1.0],
        "soft_iron": np.einsum("kij,nj->nik", ELEMENT_MATRICES, turned),
        "shielding": (turned @ LEVEL)[:, :, None],
        "installation": np.stack(axes[:2], axis=2),
        "axes": axes[2][:, :, None],
        "turned": axes[2][:, :, None],
        "latency": delayed[:, :, None],
        "gradient": (by_place[:, :, :, None] * ahead[:, None, None]).reshape(count, 3, 6),
        "place": by_place,
        "entered": added[:, :, None] * by_place,
        "came": (comes[:, None] * step)[:, :, None],
        CENTRES: centres.reshape(count, 3, -1),
    }
    if nodes.currents is not None:
        later = nodes.currents.change(shared[CURRENT_LATE])[:, None] * shared[AT["motors_current"]]
        by["current_late"] = later[:, :, None]
    at_node = (
        (ATTITUDE, by_attitude),
        (STREET, by_place * places.rest[:, None, None]),
        (BODY_FIELD, np.eye(3)),
    )
    return Residuals(nodes.field - predicted, at_node, (), by)


def _turning(shared: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the axes of roll, pitch and yaw of the installation, in the magnetometer's axes."""
    about_x = rotation_from_rpy(float(shared[ROLL_PITCH.start]), 0.0)
    return X, about_x.T @ Y, installation(shared) @ Z


def force_at_rest(measured: FloatArray, state: State) -> Residuals:
    """Return the residuals of the specific force at nodes at rest, (n, 3) in m/s²."""
    gravity = STANDARD_GRAVITY * state.attitude[:, :, 2]
    residual = measured - gravity - state.shared[AT["force_offset"]]
    by = {"force_offset": np.eye(3)}
    return Residuals(residual, [(ATTITUDE, -skews(gravity))], (), by)


def known_heading(heading: FloatArray, forward: FloatArray, state: State) -> Residuals:
    """Return the residuals of known headings at the nodes, radians.

    `heading` (n,) is the ENU yaw to magnetic north, radians, and `forward` (n, 3) its direction in
    body axes.
    """
    off, by_attitude = _heading_residual(heading, forward, state)
    residual = wrap_angle(off[:, None] - np.radians(state.local[:, HEADING_DRIFT]))
    return Residuals(residual, [(ATTITUDE, by_attitude), (HEADING_DRIFT, np.radians([1.0]))])


def known_turn(
    turned: FloatArray, seconds: FloatArray, forward: FloatArray, state: State
) -> Residuals:
    """Return the residuals of turns between nodes by the gyro, (n - 1,) radians to the left.

    `seconds` (n - 1,) are the durations over which the gyro's bias was integrated.
    """
    ahead, by_attitude = _heading_residual(np.zeros(len(forward)), forward, state)
    # `ahead` is minus the heading.
    off = turned - seconds * state.shared[BIAS_UP] + ahead[1:] - ahead[:-1]
    by = {"gyro_bias": seconds[:, None, None] * Z}
    node, later = [(ATTITUDE, -by_attitude[:-1])], [(ATTITUDE, by_attitude[1:])]
    return Residuals(wrap_angle(off)[:, None], node, later, by)


def _heading_residual(
    heading: FloatArray, forward: FloatArray, state: State
) -> tuple[FloatArray, FloatArray]:
    """Return headings minus those of a state (n,), and the latter's derivative (n, 1, 3)."""
    east, north = state.attitude[:, :, 0], state.attitude[:, :, 1]
    x, y = np.sum(east * forward, axis=1), np.sum(north * forward, axis=1)
    turned = x[:, None] * np.cross(north, forward) - y[:, None] * np.cross(east, forward)
    return wrap_angle(heading - np.arctan2(y, x)), (turned / (x**2 + y**2)[:, None])[:, None]


def second_order(state: State, row: int, correlation: FloatArray, by: tuple[int, int]) -> Residuals:
    """Return the residuals of a process by two unknowns, x[k + 1] = F x[k] + noise.

    `row` is the index of the unknown at the nodes. `correlation` (2, n - 1) are the coefficients F
    of the two unknowns `by` at the previous node.
    """
    values = state.local
    residual = np.einsum("cn,nc->n", correlation, values[:-1, by]) - values[1:, row]
    node = [(slice(c, c + 1), -f[:, None, None]) for c, f in zip(by, correlation, strict=True)]
    return Residuals(residual[:, None], node, [(slice(row, row + 1), np.ones(1))])


def process(state: State, which: slice, correlation: FloatArray) -> Residuals:
    """Return the residuals of a Gauss-Markov process, x[k + 1] = keeps[k] x[k] + noise."""
    values, eye = state.local[:, which], np.eye(which.stop - which.start)
    residual = correlation[:, None] * values[:-1] - values[1:]
    return Residuals(residual, [(which, -correlation[:, None, None] * eye)], [(which, eye)])
