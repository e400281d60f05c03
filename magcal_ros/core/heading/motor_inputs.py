"""Whether the motors run, by gyro, wheels and rests; and their field by these inputs."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magcal_ros.core.calibration.correction import MotorField, MotorInput, MotorState
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.vec3 import Triple, dot, length, minus
from magcal_ros.core.heading.heading_tuning import MOTION

MICROTESLA = 1e6


class MotionDetector:
    """Detects motion; `newest` are the inputs of the motors' field at the last call."""

    def __init__(self) -> None:
        self._moves: bool | None = None
        self._since = -math.inf
        self._stamp = self._idle = math.nan
        self.newest = MotorState(0.5, math.nan, math.nan, math.nan, math.nan)

    def at(
        self,
        stamp: float,
        rate: Triple | None,
        is_at_rest: bool,
        speed: float,
        current: float,
        reference: float = math.nan,
        upward: Triple = (0.0, 0.0, 1.0),
    ) -> MotorState:
        """Return the inputs of the motors' field at a stamp, seconds.

        `rate` is without the gyro's bias, rad/s, body axes; None without a gyro. `is_at_rest` is
        whether the IMU shows a rest or steady motion. `speed` and `current` are in m/s and amperes,
        NaN if unknown. The current is counted from `reference` (`MotorField.reference`), by default
        from that at rest. `upward` is that of the mounting. Several calibrations may ask at one
        stamp.
        """
        if stamp != self._stamp:
            seconds, self._stamp = stamp - self._stamp, stamp
            self._moves = self._motion_at(stamp, rate, is_at_rest, speed)
            may_move = float(self._moves is not False)
            turn_rate = math.nan if rate is None else dot(rate, upward) * may_move
            self.newest = MotorState(
                0.5 if self._moves is None else float(self._moves),
                turn_rate,
                speed * may_move,
                self._beyond_rest(seconds, current),
                max(-1.0, min(1.0, turn_rate / MOTION.rate)),
            )
        if math.isnan(reference):
            return self.newest
        return self.newest._replace(current=current - reference)

    def _motion_at(
        self, stamp: float, rate: Triple | None, is_at_rest: bool, speed: float
    ) -> bool | None:
        """Return whether the robot moves, None if unknown, and note when that changes."""
        turns = 0.0 if rate is None else length(rate)
        drives = 0.0 if math.isnan(speed) else abs(speed)
        moves: bool | None = False if is_at_rest else None
        if turns > MOTION.rate or drives > MOTION.speed:
            moves = True
        elif not math.isnan(speed):
            # A turn on the spot may have no speed; only a gyro excludes it.
            moves = None if rate is None else False
        if moves is not self._moves:
            # The first known state counts from the beginning.
            self._since = -math.inf if self._moves is None else stamp
        return moves

    def _beyond_rest(self, seconds: float, current: float) -> float:
        """Return a current minus that at rest, which is updated at rest."""
        rests = self._moves is False and not 0.0 <= self._stamp - self._since < MOTION.latency
        if rests and not math.isnan(current):
            share = min(max(seconds, 0.0) / MOTION.idle, 1.0)
            old = current if math.isnan(self._idle) else self._idle
            self._idle = old + share * (current - old)
        return 0.0 * current if self._moves is False else current - self._idle


class MotorInputs(NamedTuple):
    """The inputs of the motors' field at a moment; covariances in µT², (3, 3)."""

    motor_state: MotorState
    values: FloatArray
    square: FloatArray  # of K u
    otherwise: FloatArray  # of the motors' field about K u if the inputs are late or early
    level: FloatArray  # of the motors' field about K u, without the relative residual
    unknown: FloatArray  # of K u, by inputs that are unknown at this moment
    holds: bool  # whether an unmeasured current may hold the robot at rest

    @property
    def is_moving(self) -> bool:
        """Whether the robot may move."""
        return self.motor_state.moving > 0.0

    def goes_on(self, before: MotorInputs) -> bool:
        """Whether the same motors run as before."""
        if self.is_moving is not before.is_moving or self.holds is not before.holds:
            return False
        return self.holds or (self.motor_state.are_on and before.motor_state.are_on)

    def differ(self, now: MotorState) -> bool:
        """Whether motors have started or stopped since, or other inputs are known."""
        then = self.motor_state
        return then.moving != now.moving or [*map(math.isnan, then)] != [*map(math.isnan, now)]


class FieldByInputs:
    """The field of the motors by their inputs, K u, in µT and body axes.

    `matrix` (3, 3) is from the magnetometer's axes to those of the body.
    """

    def __init__(self, motors: MotorField, matrix: FloatArray) -> None:
        count = len(motors.inputs)
        self._motors = motors
        self.gains = motors.gain @ matrix.T * MICROTESLA
        turn = np.kron(np.eye(count), matrix) * MICROTESLA
        by_gains = turn @ motors.covariance @ turn.T
        self._by_gains = by_gains.reshape(count, 3, count, 3).transpose(1, 3, 0, 2)
        self._ripple = (motors.ripple * MICROTESLA) ** 2 * np.eye(3)
        usual = self.gains * np.array(motors.usual)[:, None]
        self._whole = usual.T @ usual
        late = (MotorInput.SPEED, MotorInput.CURRENT, MotorInput.ABS_SPEED)
        self.latency = np.array([MOTION.latency * (each in late) for each in motors.inputs])

    def subtracted(self, field: Triple, motor_state: MotorState) -> Triple:
        """Return a field minus K u."""
        x, y, z = (self._motors.values(motor_state) @ self.gains).tolist()
        return minus(field, (x, y, z))

    def at(self, motor_state: MotorState) -> MotorInputs:
        """Return the inputs in a state of the motors."""
        values, input_covariance = self._motors.known(motor_state)
        known, unknown = values @ self.gains, self.gains.T @ input_covariance @ self.gains
        square = known[:, None] * known
        # Motors may stand that are seen running, or run as usual before an input shows it.
        otherwise = square + self._whole
        level = motor_state.moving * self._ripple + self.by_gains(values)
        holds = motor_state.moving == 0.0 and self._motors.may_hold_robot(motor_state)
        if holds:
            # The current that holds a robot is constant, and so is its field.
            level, unknown = level + unknown, np.zeros((3, 3))
        return MotorInputs(motor_state, values, square, otherwise, level, unknown, holds)

    def usual(self, share: float) -> FloatArray:
        """Return the covariance of the field of motors that run as usual, µT², shape (3, 3).

        `share` is the squared relative residual.
        """
        values = np.array(self._motors.usual)
        known = values @ self.gains
        own = self._ripple + self.by_gains(values) + share * known[:, None] * known
        return np.asarray(self._whole + own)

    def by_gains(self, values: FloatArray) -> FloatArray:
        """Return the covariance of K u by that of the gains, for some inputs or their change."""
        return np.asarray((self._by_gains @ values) @ values)
