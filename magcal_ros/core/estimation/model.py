"""The model of one turn: what accelerometer and magnetometer should read, and its derivatives.

Every sample has an attitude of its own, `R_i = B A_i W^T`: W takes the turn's frame (its z is the
axis) to magnetic ENU, B takes it to body axes, and `A_i` turns about z, plus a small wobble.

    up_i    = B A_i W^T z              (unit, body axes)
    field_i = K R_n (I + E) R B A_i W^T m + h
    lean_i  = A_i z, whose x and y are the wobble

A local step `d` (3,) turns `A_i` into `exp([d]x) A_i`. All three vectors then change by `d x v`,
so every derivative below is a cross product: a step of B acts like a local step shared by all
samples, and a step `w` of W like the local step `-A_i w`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray
from magcal_ros.core.geometry.rotations import exp_rotations, skews, turns_about_z

DATA_ROWS = 6
"""Residuals of one sample: three of up (turn's frame, two degrees of freedom), three of field."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Measurements in the fit's own units.

    Parameters
    ----------
    up : ndarray, shape (n, 3)
        Unit up vectors in body axes.
    field : ndarray, shape (n, 3)
        Raw field in units of the field scale.
    mounting : ndarray, shape (3, 3)
        Known gains times nominal pose, body to sensor axes.
    """

    up: FloatArray
    field: FloatArray
    mounting: FloatArray

    def __len__(self) -> int:
        return len(self.up)

    def take(self, rows: BoolArray | slice) -> Samples:
        """Return the samples of the chosen rows."""
        return Samples(self.up[rows], self.field[rows], self.mounting)


@dataclass(frozen=True, eq=False)
class State:
    """Globals, and the attitude A_i of each sample in the turn's frame, shape (n, 3, 3)."""

    shared: Globals
    attitude: FloatArray

    def moved(self, step: FloatArray, local_step: FloatArray) -> State:
        """Return the state after a global step (18,) and local steps (n, 3) or (n, 1) about z."""
        turns = exp_rotations(local_step) if local_step.shape[1] == 3 else about_z(local_step[:, 0])
        return State(self.shared.moved(step), turns @ self.attitude)

    def upright(self) -> State:
        """Return the state without wobble: each attitude becomes the nearest turn about z."""
        return State(self.shared, about_z(turns_about_z(self.attitude)))

    @property
    def lean(self) -> FloatArray:
        """The axis in the turn's frame, `A_i z`; x and y are the wobble. Shape (n, 3)."""
        return self.attitude[:, :, 2]


@dataclass(frozen=True, eq=False)
class Prediction:
    """What the model says of each sample.

    Parameters
    ----------
    up, field : ndarray, shape (n, 3)
        Up and reference field in the turn's frame.
    field_matrix : ndarray, shape (3, 3)
        From the field in the turn's frame to the raw field.
    up_residual : ndarray, shape (n, 3)
        Measured minus predicted up, in the turn's frame.
    field_residual : ndarray, shape (n, 3)
        Measured minus predicted raw field.
    """

    up: FloatArray
    field: FloatArray
    field_matrix: FloatArray
    up_residual: FloatArray
    field_residual: FloatArray


def predict(state: State, samples: Samples) -> Prediction:
    """Evaluate the model at a state."""
    shared = state.shared
    up = state.attitude @ shared.world_axis[2]
    field = state.attitude @ (shared.world_axis.T @ shared.field_enu)
    matrix = shared.distortion(samples.mounting) @ shared.body_axis
    return Prediction(
        up,
        field,
        matrix,
        samples.up @ shared.body_axis - up,
        samples.field - (field @ matrix.T + shared.hard_iron),
    )


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A state, and the samples that the model is held against there."""

    state: State
    samples: Samples

    @cached_property
    def prediction(self) -> Prediction:
        """What the model says of each sample here."""
        return predict(self.state, self.samples)

    @cached_property
    def squares(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Squared residuals of up and field, and squared leans, of each sample; (n,) each."""
        prediction, leans = self.prediction, self.state.lean[:, :2]
        parts = (prediction.up_residual, prediction.field_residual, leans)
        up, field, lean = (np.einsum("ij,ij->i", part, part) for part in parts)
        return up, field, lean

    def moved(self, step: FloatArray, local_step: FloatArray) -> Evaluation:
        """Return the place after a global step (18,) and local steps, as `State.moved` does."""
        return Evaluation(self.state.moved(step, local_step), self.samples)


def local_jacobian(prediction: Prediction) -> FloatArray:
    """Return the derivative of up and field by the local step, shape (n, 6, 3)."""
    crosses = np.stack([skews(prediction.up), skews(prediction.field)], axis=1)
    crosses[:, 1] = prediction.field_matrix @ crosses[:, 1]
    return np.asarray(-crosses.reshape(-1, DATA_ROWS, 3))


def global_jacobian(
    state: State, prediction: Prediction, local: FloatArray, samples: Samples
) -> FloatArray:
    """Return the derivative of up and field by the globals, shape (n, 6, 18).

    Parameters
    ----------
    state, prediction, samples
        Where to differentiate.
    local : ndarray, shape (n, 6, 3)
        `local_jacobian` at the same place.
    """
    shared = state.shared
    jacobian = np.zeros((len(samples), DATA_ROWS, p.COUNT))
    jacobian[:, :, p.BODY_AXIS] = local[:, :, :2]
    jacobian[:, :, p.WORLD_AXIS] = -local @ state.attitude[:, :, :2]
    field_rows = jacobian[:, 3:]
    matrices = shared.distortion_derivatives(samples.mounting) @ shared.body_axis
    columns = np.moveaxis(prediction.field @ np.swapaxes(matrices, 1, 2), 0, 2)
    field_rows[:, :, p.MATRIX_PARAMETERS] = columns
    field_rows[:, :, p.HARD_IRON] = np.eye(3)
    field_rows[:, :, p.STRENGTH] = prediction.field @ (prediction.field_matrix.T / shared.strength)
    by_inclination = field_by_inclination(state)
    field_rows[:, :, p.INCLINATION] = by_inclination @ prediction.field_matrix.T
    return jacobian


def field_by_inclination(state: State) -> FloatArray:
    """Return the derivative of the field in the turn's frame by the inclination, shape (n, 3)."""
    shared = state.shared
    return np.asarray(state.attitude @ (shared.world_axis.T @ shared.field_enu_by_inclination))


def about_z(angle: FloatArray) -> FloatArray:
    """Return turns by each angle (n,) about z, shape (n, 3, 3)."""
    out = np.zeros((len(angle), 3, 3))
    out[:, 0, 0] = out[:, 1, 1] = np.cos(angle)
    out[:, 1, 0] = np.sin(angle)
    out[:, 0, 1] = -out[:, 1, 0]
    out[:, 2, 2] = 1.0
    return out
