"""The present field of the motors.

The inputs have latency and no ripple: a current is reported some tenths of a second late, and
motion is detected after the motors have started. The field of the place cannot change as fast,
except by the turn that the gyro measures. A Kalman filter on the field of the place and on the
residual of the motors' field therefore separates the two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magcal_ros.core.calibration.correction import AT_REST, MotorField, MotorInput, MotorState
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import exp_rotation, skew
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.heading.motion_detector import MOTION
from magcal_ros.core.knowledge import STREET_LENGTH
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.up.filter import GYRO

MICROTESLA = 1e6
PLACE, RESIDUAL = slice(0, 3), slice(3, 6)
"""States: field of the place, and residual of the motors' field; µT, body axes."""
EYE = np.eye(3)


@dataclass(frozen=True)
class PlaceFieldTuning:
    """How the field of a place changes in the axes of a robot."""

    field: float = 100.0  # prior sigma of the field before the first sample, µT
    street: float = 1.0  # size of the local disturbance, µT per axis, median
    passing: float = 0.03  # random walk of the field at rest, µT per root second
    latency: float = 0.01  # seconds between gyro and field
    beside: float = 0.15  # distance of the magnetometer from the pivot, metres
    unknown_speed: float = 0.3  # m/s of a moving robot without a known speed

    def path(self, speed: float, rate: Triple) -> float:
        """Return the speed of the magnetometer, m/s, for that of the robot (or NaN) and a rate."""
        known = self.unknown_speed if math.isnan(speed) else abs(speed)
        return math.hypot(known, self.beside * math.hypot(*rate))

    def change(
        self, place: FloatArray, turned: FloatArray, faster: FloatArray, path: float, seconds: float
    ) -> FloatArray:
        """Return the process noise of the field of the place, µT², shape (3, 3).

        The local disturbance is not included (`path_variance`). `place` (3,) is the field in µT,
        body axes, `turned` (3,) the rotation of the robot, radians, `faster` (3,) the change of the
        turn rate, rad/s, and `path` the path of the magnetometer, metres, zero at rest.
        """
        lost = GYRO.walk_variance(math.sqrt(float(turned @ turned)), seconds * (path > 0.0))
        lost += self.latency**2 * float(faster @ faster)
        passing = self.passing**2 * seconds
        return np.asarray(
            (lost * float(place @ place) + passing) * EYE - lost * place[:, None] * place
        )

    def path_variance(self, path: float) -> float:
        """Return the process noise by a path in metres, for a local disturbance of 1 µT, µT²."""
        return 2.0 * path / STREET_LENGTH


PLACE_FIELD = PlaceFieldTuning()


def _log_normal(median: float, steps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return sizes on a grid of the natural logarithm, whose sigma is one, and their prior odds."""
    odds = np.exp(-0.5 * steps**2)
    return median * np.exp(steps), odds / odds.sum()


_SHARES, _SHARE_ODDS = _log_normal(MOTION.unseen, np.linspace(-1.5, 2, 6))
_STREETS, _STREET_ODDS = _log_normal(PLACE_FIELD.street, np.linspace(-1.2, 1.2, 3))
UNSEEN, STREET = (each.ravel() for each in np.meshgrid(_SHARES, _STREETS))
"""Tried pairs: relative residual of the motors' field, and size of the local disturbance, µT."""
ODDS = np.outer(_STREET_ODDS, _SHARE_ODDS).ravel()
"""Their prior odds."""


class MotorCovariance(NamedTuple):
    """Errors of a sample's field after the motors' field was subtracted, tesla².

    The subtracted field contains a part of the sample's noise, which cancels.
    """

    lasting: FloatArray  # covariance (3, 3) without the sample's noise
    noise: FloatArray  # covariance (3, 3) of the remaining noise of the sample


class _Update(NamedTuple):
    """The update by a sample, for each tried pair."""

    likelihood: FloatArray  # logarithms, (g,)
    step: FloatArray  # (g, 6)
    covariance: FloatArray  # (g, 6, 6)
    left: FloatArray  # (g, 3)
    lasting: FloatArray  # (g, 3, 3)
    noise: FloatArray  # (g, 3, 3)


class MotorFieldFilter:
    """Estimates the field of the place and the residual of the motors' field.

    The size of the residual is unknown: there is a filter for each pair of `UNSEEN` and `STREET`,
    and `odds` are their posterior probabilities.

    `matrix` (3, 3) is from the magnetometer's axes to those of the body, and `noise` (3, 3) the
    covariance of a corrected sample, tesla². `iron` (3, 3) is the covariance of the corrected field
    by that of the calibration, tesla², which does not rotate like the field of the place.
    """

    def __init__(
        self, motors: MotorField, matrix: FloatArray, iron: FloatArray, noise: FloatArray
    ) -> None:
        self._matrix = matrix
        self._iron = iron * MICROTESLA**2
        self._of_sample = noise
        self._noise = noise * MICROTESLA**2 + 1e-4 * EYE
        self._mean = np.zeros((len(UNSEEN), 6))
        self._covariance = np.zeros((len(UNSEEN), 6, 6))
        self.odds: FloatArray = ODDS
        self._rate, self._before = np.zeros(3), AT_REST
        self._stamp, self._late_since = -math.inf, math.nan
        self._values = self._change = np.zeros(0)
        self.use(motors)

    def use(self, motors: MotorField) -> None:
        """Use another estimate of the motors' field from now on."""
        count = len(motors.inputs)
        self._motors = motors
        self._gains = motors.gain @ self._matrix.T * MICROTESLA
        turn = np.kron(np.eye(count), self._matrix) * MICROTESLA
        by_gains = turn @ motors.covariance @ turn.T
        self._by_gains = by_gains.reshape(count, 3, count, 3).transpose(1, 3, 0, 2)
        self._ripple = (motors.ripple * MICROTESLA) ** 2
        usual = self._gains * np.array(motors.usual)[:, None]
        self._whole = usual.T @ usual
        most = self._whole + self._mean_of(self._level(MotorState(1.0), np.array(motors.usual)))
        # Motors within the noise of a sample are not worth the computation.
        self._is_felt = bool(np.trace(most) > np.trace(self._noise))
        late = (MotorInput.SPEED, MotorInput.CURRENT, MotorInput.ABS_SPEED)
        self._latency = np.array([MOTION.latency * (each in late) for each in motors.inputs])
        if len(self._values) != count:
            self._values, self._change = np.zeros(count), np.zeros(count)

    def add(
        self, stamp: float, field: Triple, rate: Triple | None, motor_state: MotorState
    ) -> tuple[Triple, MotorCovariance]:
        """Add a corrected sample; return it minus K u and the residual, and its errors.

        `field` is in tesla, body axes, `rate` in rad/s without the gyro's bias, None without a
        gyro.
        """
        values, input_covariance = self._motors.known(motor_state)
        if not self._is_felt or rate is None:
            if not motor_state.are_on and not input_covariance.any():
                return field, MotorCovariance(np.zeros((3, 3)), self._of_sample)
            return self._by_inputs(field, motor_state, values, input_covariance)
        unknown = self._gains.T @ input_covariance @ self._gains
        level, holds = self._level(motor_state, values), self._may_hold(motor_state)
        if holds:
            # The current that holds a robot is constant, and so is its field.
            level, unknown = level + unknown, np.zeros((3, 3))
        self._predict(stamp, rate, motor_state, values, level)
        known = values @ self._gains
        measured = MICROTESLA * np.array(field) - known
        # Motors may stand that are seen running, or run as usual before an input shows it.
        otherwise = known[:, None] * known + self._whole
        one, other = self._updates(measured, unknown, unknown + otherwise)
        late = self._late(stamp, other.likelihood - one.likelihood)
        if late is None:
            # A lasting change is no start or stop: it is another motor, or at rest the place.
            is_place = motor_state.moving == 0.0 and not holds
            self._forget(PLACE if is_place else RESIDUAL, otherwise)
            one, other = self._updates(measured, unknown, unknown)
            late = np.zeros(len(UNSEEN))
        elif motor_state.moving > 0.0:
            self._weigh(one.likelihood, late)
        each, whole = late[:, None], late[:, None, None]
        self._mean = self._mean + one.step + each * (other.step - one.step)
        self._covariance = _mixed(late, one.covariance, other.covariance, other.step - one.step)
        left = one.left + each * (other.left - one.left)
        spread = _mixed(late, one.lasting, other.lasting, other.left - one.left)
        noise = self._mean_of(one.noise + whole * (other.noise - one.noise))
        mean = self.odds @ left
        spread = self._mean_of(spread) + (left - mean).T @ (self.odds[:, None] * (left - mean))
        x, y, z = ((measured - mean) / MICROTESLA).tolist()
        return (x, y, z), MotorCovariance(spread / MICROTESLA**2, noise / MICROTESLA**2)

    def _by_inputs(
        self,
        field: Triple,
        motor_state: MotorState,
        values: FloatArray,
        input_covariance: FloatArray,
    ) -> tuple[Triple, MotorCovariance]:
        """Return a sample minus K u alone, for a residual that samples cannot show."""
        x, y, z = (values @ self._gains / MICROTESLA).tolist()
        spread = (
            self._mean_of(self._level(motor_state, values))
            + self._gains.T @ input_covariance @ self._gains
        )
        known = MotorCovariance(spread / MICROTESLA**2, self._of_sample)
        return (field[0] - x, field[1] - y, field[2] - z), known

    def _mean_of(self, each: FloatArray) -> FloatArray:
        """Return the mean over the tried pairs, weighted by their odds."""
        return np.asarray(np.tensordot(self.odds, each, 1))

    def _level(self, motor_state: MotorState, values: FloatArray) -> FloatArray:
        """Return the covariance of the motors' field about K u, µT², (g, 3, 3)."""
        by_gains = (self._by_gains @ values) @ values
        known = values @ self._gains
        beside = motor_state.moving * self._ripple * EYE + by_gains
        return np.asarray(beside + np.square(UNSEEN)[:, None, None] * (known[:, None] * known))

    def _late(self, stamp: float, odds: FloatArray) -> FloatArray | None:
        """Return the probability of an undetected start or stop of motors; None if it lasts."""
        share = MOTION.late_share
        late = share / (share + (1.0 - share) * np.exp(np.minimum(-odds, 300.0)))
        if self.odds @ late < 0.5:
            self._late_since = math.nan
        elif math.isnan(self._late_since):
            self._late_since = stamp
        elif stamp - self._late_since > MOTION.longest:
            self._late_since = math.nan
            return None
        return np.asarray(late)

    def _weigh(self, likelihood: FloatArray, late: FloatArray) -> None:
        """Update the odds of the tried pairs by a sample."""
        seen = likelihood - np.log1p(-np.minimum(late, 1.0 - 1e-12))
        odds = self.odds * np.exp(seen - seen.max())
        self.odds = odds / odds.sum()

    def _updates(
        self, measured: FloatArray, unknown: FloatArray, otherwise: FloatArray
    ) -> tuple[_Update, _Update]:
        """Return the updates by a sample, under two covariances of the motors' field."""
        mean, covariance = self._mean, self._covariance
        either = np.stack([unknown, otherwise])[:, None]
        off = (measured - mean[:, PLACE] - mean[:, RESIDUAL])[:, :, None]
        both = covariance[:, :, PLACE] + covariance[:, :, RESIDUAL]
        inverse = np.linalg.inv(both[:, PLACE] + both[:, RESIDUAL] + either + self._noise)
        left = both[:, RESIDUAL] + either
        missed, seen = inverse @ off, left @ inverse
        rest = EYE - seen
        # The residual contains a part of the sample's noise, which cancels in the difference.
        lasting = covariance[:, RESIDUAL, RESIDUAL] + either - seen @ left.swapaxes(2, 3)
        lasting = lasting - seen @ self._noise @ seen.swapaxes(2, 3)
        found = (
            0.5 * (np.log(np.linalg.det(inverse)) - np.sum(off * missed, axis=(2, 3))),
            (both @ missed)[:, :, :, 0],
            covariance - both @ inverse @ both.swapaxes(1, 2),
            mean[:, RESIDUAL] + (left @ missed)[:, :, :, 0],
            lasting,
            rest @ self._noise @ rest.swapaxes(2, 3),
        )
        return _Update(*(each[0] for each in found)), _Update(*(each[1] for each in found))

    def _may_hold(self, motor_state: MotorState) -> bool:
        """Whether an unmeasured current may hold the robot at rest."""
        return motor_state.moving == 0.0 and self._motors.may_hold_robot(motor_state)

    def _predict(
        self,
        stamp: float,
        rate: Triple,
        motor_state: MotorState,
        values: FloatArray,
        level: FloatArray,
    ) -> None:
        seconds, self._stamp = stamp - self._stamp, stamp
        before = self._before
        moves, moved = motor_state.moving > 0.0, before.moving > 0.0
        holds, held = self._may_hold(motor_state), self._may_hold(before)
        now = np.array(rate)
        changed, self._values = values - self._values, values
        faster, self._rate, self._before = now - self._rate, now, motor_state
        if not 0.0 < seconds < STREAMS.longest_field_gap:
            self._forget(PLACE, level)
            self._forget(RESIDUAL, level)
            self._change = np.zeros(len(values))
            return
        share = min(seconds / MOTION.latency, 1.0)
        self._change = self._change + share * (changed / seconds - self._change)
        turned = seconds * moves * (now - 0.5 * faster)
        # Motors may hold a robot at rest.
        alike = (
            moves is moved and holds is held and (holds or (motor_state.are_on and before.are_on))
        )
        lasts = math.inf if holds else MOTION.body_length
        keeps = math.exp(-seconds / lasts) if alike else 0.0
        if moves:
            self.odds = self.odds + seconds / MOTION.unseen_time * (ODDS - self.odds)
        step = np.zeros((6, 6))
        step[PLACE, PLACE], step[RESIDUAL, RESIDUAL] = exp_rotation(-turned), keeps * EYE
        self._mean = self._mean @ step.T
        covariance = step @ self._covariance @ step.T
        path = seconds * moves * PLACE_FIELD.path(motor_state.speed, rate)
        place = self.odds @ self._mean[:, PLACE]
        covariance[:, PLACE, PLACE] += PLACE_FIELD.change(place, turned, faster, path, seconds)
        path_variance = PLACE_FIELD.path_variance(path) * np.square(STREET)
        across = skew(turned) / math.sqrt(max(math.sqrt(float(turned @ turned)), 1e-12))
        iron = across @ self._iron @ across.T
        covariance[:, PLACE, PLACE] += path_variance[:, None, None] * EYE + iron
        # Within the latency, the residual changes by as much as the inputs.
        late = 0.5 * MOTION.body_length / MOTION.latency * self._latency**2
        level = level + self._gains.T @ np.diag(late * self._change**2) @ self._gains
        covariance[:, RESIDUAL, RESIDUAL] += (1.0 - keeps**2) * level
        covariance[:, RESIDUAL, RESIDUAL] += keeps**2 * (self._by_gains @ changed) @ changed
        self._covariance = covariance

    def _forget(self, which: slice, level: FloatArray) -> None:
        """Reset the field of the place, or the residual to the covariance `level`."""
        self._mean[:, which] = 0.0
        self._covariance[:, which] = self._covariance[:, :, which] = 0.0
        unknown = PLACE_FIELD.field**2 * EYE if which is PLACE else level
        self._covariance[:, which, which] = unknown


def _mixed(share: FloatArray, one: FloatArray, other: FloatArray, apart: FloatArray) -> FloatArray:
    """Return the covariances of mixtures of two each, with means that differ by `apart`."""
    part = share[:, None, None]
    apart = apart[:, :, None] * apart[:, None, :]
    spread = one + part * (other - one) + part * (1.0 - part) * apart
    return np.asarray(0.5 * (spread + spread.swapaxes(1, 2)))
