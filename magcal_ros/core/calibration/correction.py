"""The twelve numbers of a calibration, and the field of a robot's running motors.

Every calibration has one form: `m_body = A (m_raw - h)`. The motors add a field in proportion to
speed, turn rate and current.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from magcal_ros.core.geometry.arrays import FloatArray, freeze

PARAMETERS = 12
"""A row by row (9, dimensionless), then h (3, tesla): the order of every 12 x 12 covariance."""


@dataclass(frozen=True, eq=False)
class Correction:
    """Maps the raw field to the field in body axes, `A (m_raw - h)`.

    Raises ValueError if a number is not finite, or if `matrix` is singular or mirrors the axes.
    """

    matrix: FloatArray  # A, dimensionless; must be invertible and keep handedness. Shape (3, 3).
    hard_iron: FloatArray  # h in tesla, in the magnetometer's axes. Shape (3,).

    def __post_init__(self) -> None:
        freeze(self, matrix=(3, 3), hard_iron=(3,))
        if np.linalg.det(self.matrix) <= 1e-9:
            raise ValueError("the correction matrix is singular or mirrors the axes")

    @classmethod
    def identity(cls) -> Correction:
        """Return the correction that changes nothing."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_parameters(cls, parameters: npt.ArrayLike) -> Correction:
        """Build from the twelve numbers in the order of `parameters`."""
        numbers = np.asarray(parameters, dtype=np.float64)
        return cls(numbers[:9].reshape(3, 3), numbers[9:])

    @property
    def parameters(self) -> FloatArray:
        """The twelve numbers: A row by row, then h; shape (12,)."""
        return np.concatenate([self.matrix.ravel(), self.hard_iron])

    def is_same(self, other: Correction) -> bool:
        """Whether all twelve numbers are equal."""
        return np.array_equal(self.parameters, other.parameters)

    def apply(self, field: FloatArray) -> FloatArray:
        """Correct fields (..., 3) in tesla; returns body axes, same shape and unit."""
        return np.asarray((field - self.hard_iron) @ self.matrix.T)

    def undo(self, field_body: FloatArray) -> FloatArray:
        """Return the raw fields (..., 3) that `apply` maps to `field_body`."""
        return np.asarray(field_body @ np.linalg.inv(self.matrix).T + self.hard_iron)

    def covariance(self, sigma: FloatArray) -> FloatArray:
        """Return the covariance (3, 3) of a raw field sample in body axes, `A S A^T`."""
        return np.asarray(self.matrix @ sigma @ self.matrix.T)

    def in_axes(self, rotation: FloatArray) -> Correction:
        """Return the same correction to body axes that are rotated by `rotation` (3, 3)."""
        return Correction(rotation @ self.matrix, self.hard_iron)

    def after(self, first: Correction) -> Correction:
        """Return the correction equal to applying `first` and then this one."""
        matrix = self.matrix @ first.matrix
        return Correction(matrix, first.hard_iron + np.linalg.solve(first.matrix, self.hard_iron))


class MotorInput(str, Enum):
    """Inputs that the motors' field may be proportional to, in the order of `MotorState.values`."""

    MOVING = "moving"
    TURN_RATE = "turn_rate"
    SPEED = "speed"
    CURRENT = "current"
    SIDE = "side"
    ABS_TURN_RATE = "abs_turn_rate"
    ABS_SPEED = "abs_speed"

    @property
    def unit(self) -> str:
        """The unit of the input."""
        units = {"turn_rate": "rad/s", "speed": "m/s", "current": "A"}
        words = {"moving": "while it moves", "side": "while it turns left, less right"}
        return {**units, **words}[self.value.removeprefix("abs_")]


INPUTS = tuple(MotorInput)


class MotorState(NamedTuple):
    """Values of the motors' inputs at a moment."""

    moving: float = 0.0  # probability that the robot moves
    turn_rate: float = 0.0  # rad/s about `Mounting.upward`; NaN if unknown, like the following ones
    speed: float = 0.0  # m/s, negative backwards
    current: float = 0.0  # amperes beyond `MotorField.reference`, of a constant sign convention
    side: float = 0.0  # one in a turn to the left, minus one to the right, between at low rates

    @property
    def are_on(self) -> bool:
        """Whether motors run: the robot moves, or there is a current at rest."""
        return self.moving > 0.0 or abs(self.current) > 0.0

    @property
    def values(self) -> tuple[float, ...]:
        """All inputs: the field of a current may change its sign with the motion or not."""
        return (*self, abs(self.turn_rate), abs(self.speed))


AT_REST = MotorState()


@dataclass(frozen=True, eq=False)
class MotorField:
    """The field of the motors, `K u` in addition to the hard iron, with covariances."""

    inputs: tuple[MotorInput, ...]
    gain: FloatArray
    """K by inputs: tesla per unit of each, in the magnetometer's axes. Shape (n, 3)."""
    covariance: FloatArray  # of the gains, input by input, tesla² per units. Shape (3 n, 3 n).
    cross_covariance: (
        FloatArray  # covariance with the twelve numbers of the calibration. Shape (12, 3 n).
    )
    ripple: float
    """Standard deviation of the field about K u while the robot moves, tesla per axis."""
    usual: tuple[float, ...]
    """Root mean square of each input while the robot moves, for an input that is not measured."""
    reference: float = math.nan
    """Current to which the calibration refers, amperes; NaN if it refers to the robot at rest with
    any current. Motors that hold a robot at rest add the field of the current beyond it."""

    def __post_init__(self) -> None:
        count = len(self.inputs)
        size = 3 * count
        freeze(self, gain=(count, 3), covariance=(size, size), cross_covariance=(PARAMETERS, size))
        if len(self.usual) != count or len(set(self.inputs)) != count:
            raise ValueError("the motors' inputs must differ, and each has one usual size")

    def may_hold_robot(self, motor_state: MotorState) -> bool:
        """Whether motors may hold the robot with an unmeasured current."""
        return math.isnan(motor_state.current) and not math.isnan(self.reference)

    def values(self, motor_state: MotorState) -> FloatArray:
        """Return the inputs (n,), zero where they are unknown."""
        every = [0.0 if math.isnan(each) else each for each in motor_state.values]
        return np.array([every[INPUTS.index(each)] for each in self.inputs])

    def known(self, motor_state: MotorState) -> tuple[FloatArray, FloatArray]:
        """Return the inputs (n,) and their covariance (n, n).

        An unknown input is zero, with its usual variance while the robot moves. A current beyond a
        reference, which may hold the robot, has this variance at rest as well. If motion or side of
        a turn are uncertain, so are the inputs that depend on them.
        """
        every = motor_state.values
        inputs = [every[INPUTS.index(each)] for each in self.inputs]
        moving = motor_state.moving
        side = 0.0 if math.isnan(motor_state.side) else abs(motor_state.side)
        are_on = 1.0 if self.may_hold_robot(motor_state) else moving
        share = {MotorInput.CURRENT: are_on}
        variances = [
            share.get(each, moving) * usual**2 if math.isnan(value) else 0.0
            for each, value, usual in zip(self.inputs, inputs, self.usual, strict=True)
        ]
        if MotorInput.SIDE in self.inputs:
            variances[self.inputs.index(MotorInput.SIDE)] += moving * side * (1.0 - side)
        covariance = np.diag(variances)
        if 0.0 < moving < 1.0:
            step = {MotorInput.MOVING: 1.0, MotorInput.SIDE: motor_state.side}
            steps = np.nan_to_num([step.get(each, 0.0) for each in self.inputs])
            covariance += moving * (1.0 - moving) * np.outer(steps, steps)
        return self.values(motor_state), covariance

    def joint(self, covariance: FloatArray) -> FloatArray:
        """Return the covariance of the twelve numbers and the gains, (12 + 3 n, 12 + 3 n)."""
        return np.block(
            [[covariance, self.cross_covariance], [self.cross_covariance.T, self.covariance]]
        )

    def sigma(self, which: int) -> float:
        """Return the standard deviation of an input's gain over all axes, tesla per unit."""
        at = slice(3 * which, 3 * which + 3)
        return math.sqrt(float(np.trace(self.covariance[at, at])))

    def size(self, which: int) -> float:
        """Return the field at the usual size of an input, tesla."""
        return float(np.linalg.norm(self.gain[which])) * self.usual[which]

    def with_numbers_changed(self, change: FloatArray) -> MotorField:
        """Return the same field; `change` (12, 12) is the derivative of other twelve numbers."""
        return replace(self, cross_covariance=change @ self.cross_covariance)

    def with_another_calibration(self) -> MotorField:
        """Return the same field, uncorrelated with the twelve numbers."""
        return replace(self, cross_covariance=np.zeros_like(self.cross_covariance))

    def with_twin(self, which: MotorInput, twin: MotorInput, side: float) -> MotorField:
        """Return the same field with a `twin` of an input, whose sign depends on the side or not.

        Turns to one `side` cannot separate the two: either may be the whole field.
        """
        at, count = self.inputs.index(which), 3 * len(self.inputs)
        split, apart = np.eye(count + 3, count), np.zeros((count + 3, 3))
        step, turned = slice(3 * at, 3 * at + 3), math.copysign(1.0, side)
        split[step, step], split[count:, step] = 0.5 * np.eye(3), 0.5 * turned * np.eye(3)
        apart[step], apart[count:] = np.eye(3), -turned * np.eye(3)
        whole = np.outer(self.gain[at], self.gain[at]) + self.covariance[step, step]
        return MotorField(
            (*self.inputs, twin),
            (split @ self.gain.ravel()).reshape(-1, 3),
            split @ self.covariance @ split.T + apart @ (0.25 * whole) @ apart.T,
            self.cross_covariance @ split.T,
            self.ripple,
            (*self.usual, self.usual[at]),
            self.reference,
        )

    def combined_with(self, older: MotorField) -> MotorField:
        """Return this field, with the inputs that only an older one has."""
        rows = [k for k, each in enumerate(older.inputs) if each not in self.inputs]
        numbers = [3 * k + axis for k in rows for axis in range(3)]
        count = len(numbers)
        apart = np.zeros((len(self.covariance), count))
        added = older.covariance[np.ix_(numbers, numbers)]
        return MotorField(
            (*self.inputs, *(older.inputs[k] for k in rows)),
            np.vstack([self.gain, older.gain[rows]]),
            np.block([[self.covariance, apart], [apart.T, added]]),
            np.hstack([self.cross_covariance, np.zeros((PARAMETERS, count))]),
            self.ripple,
            (*self.usual, *(older.usual[k] for k in rows)),
            self.reference,
        )

    def improves_on(self, other: MotorField | None, share: float) -> bool:
        """Whether an input is new, has a sigma below `share` of the other's, or has changed."""
        if other is None or set(self.inputs) - set(other.inputs):
            return True
        for k, each in enumerate(self.inputs):
            j = other.inputs.index(each)
            change = float(np.linalg.norm(self.gain[k] - other.gain[j]))
            if self.sigma(k) < share * other.sigma(j) or change > 3.0 * other.sigma(j):
                return True
        return False
