"""Whether motors run, and what field they add at the moment.

Inputs come late and leave out a ripple: a current is reported some tenths of a second after it
flows, and that a robot moves is seen after its motors have started. The field of the place cannot
change so fast, except by the turn that the gyro measures. So a Kalman filter on the field of the
place and on what is left of the motors' field divides each change between the two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magcal_ros.core.calibration.correction import AT_REST, MotorField, MotorInput, Running
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import exp_rotation
from magcal_ros.core.geometry.vec3 import Triple, length


@dataclass(frozen=True)
class RunningTuning:
    """When a robot moves, and how well the inputs show what its motors add."""

    rate: float = 0.03  # rad/s from which it turns, as for the smoother (`Lengths.moving`)
    speed: float = 0.01  # m/s from which it drives: below a step of a wheel's encoder
    turning: float = 0.1  # rad/s at which it surely turns to one side
    slow: float = 0.05  # m/s below which it is about to stop, and twice `rate` likewise
    edge: float = 0.1  # seconds after a start or stop in which it is not known what runs
    slowing: float = 0.3  # the same after the robot got slow
    settles: float = 0.7  # seconds at rest after which the current is that of rest
    idle: float = 5.0  # seconds over which that is averaged
    body_length: float = 4.0  # seconds over which what no input shows is alike
    unseen: float = 0.25
    """Share of what an input shows by which the motors' field differs from it, along its direction:
    at an even speed the currents of wheels vary by a fifth to a third, with the floor and bends."""
    late_share: float = 0.03  # of the time in which motors run unseen, or do not
    longest: float = 0.5  # seconds that this lasts at most
    latency: float = 0.2  # seconds by which a speed or a current may be late


RUNNING = RunningTuning()


class MotionSense:
    """Follows whether a robot moves; `newest` is what the motors did when it was asked last."""

    def __init__(self) -> None:
        self._moves: bool | None = None
        self._is_slow = True
        self._since = self._slow_since = -math.inf
        self._stamp = self._idle = math.nan
        self.newest = Running(0.5, math.nan, math.nan, math.nan, math.nan)

    def at(
        self, stamp: float, rate: Triple | None, is_at_rest: bool, speed: float, current: float
    ) -> Running:
        """Return what the motors do at a stamp, seconds; stamps go on or jump.

        `rate` is less the gyro's bias, rad/s, body axes; None without a gyro. `is_at_rest` is
        whether the IMU shows that the robot stands, or rolls on evenly. `speed` and `current` are
        in m/s and amperes, NaN where they are unknown. Of the current only what is beyond that at
        rest counts: the calibration is that of the robot at rest.
        """
        if stamp == self._stamp:
            return self.newest
        seconds, self._stamp = stamp - self._stamp, stamp
        turns = 0.0 if rate is None else length(rate)
        drives = 0.0 if math.isnan(speed) else abs(speed)
        moves: bool | None = False if is_at_rest else None
        if turns > RUNNING.rate or drives > RUNNING.speed:
            moves = True
        elif not math.isnan(speed):
            # Wheels that stand do not show a turn on the spot; the gyro would.
            moves = None if rate is None else False
        if moves is not self._moves:
            # What is not known at first was as it is now.
            self._since = -math.inf if self._moves is None else stamp
            self._moves = moves
        is_slow = turns < 2.0 * RUNNING.rate and drives < RUNNING.slow
        if is_slow and not self._is_slow:
            self._slow_since = stamp
        self._is_slow = is_slow
        is_edge = 0.0 <= stamp - self._since < RUNNING.edge
        is_edge = is_edge or (moves is True and 0.0 <= stamp - self._slow_since < RUNNING.slowing)
        share = 0.5 if moves is None or is_edge else float(moves)
        turn_rate = math.nan if rate is None else rate[2] * float(moves is not False)
        driven = speed * float(moves is not False)
        side = max(-1.0, min(1.0, turn_rate / RUNNING.turning))
        if is_edge and moves is False:
            # Motors of a turn that has just ended may still run to its side.
            side = self.newest.side
        beyond = self._beyond_rest(moves, seconds, current)
        self.newest = Running(share, turn_rate, driven, beyond, side)
        return self.newest

    def _beyond_rest(self, moves: bool | None, seconds: float, current: float) -> float:
        """Return by how much a current, if known, is beyond that at rest, and follow the latter."""
        rests = moves is False and self._stamp - self._since > RUNNING.settles
        if rests and not math.isnan(current):
            share = min(max(seconds, 0.0) / RUNNING.idle, 1.0)
            old = current if math.isnan(self._idle) else self._idle
            self._idle = old + share * (current - old)
        return 0.0 * current if moves is False else current - self._idle


MICROTESLA = 1e6
PLACE, LEFT = slice(0, 3), slice(3, 6)
"""States: field of the place, and what is left of the motors' field; µT, body axes."""
EYE = np.eye(3)


@dataclass(frozen=True)
class PlaceFieldTuning:
    """How the field of a place changes in the axes of a robot."""

    field: float = 100.0  # µT of the Earth's field and all around it, before the first sample
    longest: float = 1.0  # seconds without a sample after which the field of the place is unknown
    street: float = 2.0  # µT per axis by which places differ
    street_length: float = 30.0  # metres over which they are alike
    passing: float = 0.03  # µT per root second by which the field changes while the robot stands
    walk: float = 0.002  # rad per root second of the gyro's random walk
    turn_error: float = 0.01  # share of an angle that a gyro gets wrong, as a random walk
    latency: float = 0.01  # seconds by which gyro and field may be apart
    beside: float = 0.15  # metres of the magnetometer from the pivot
    unknown_speed: float = 0.3  # m/s of a robot that moves and does not tell its speed

    def way(self, speed: float, rate: Triple) -> float:
        """Return the metres a second of the magnetometer at a speed (m/s or NaN) and turn rate."""
        known = self.unknown_speed if math.isnan(speed) else abs(speed)
        return math.hypot(known, self.beside * math.hypot(*rate))

    def change(
        self, place: FloatArray, turned: FloatArray, faster: FloatArray, way: float, seconds: float
    ) -> FloatArray:
        """Return the covariance that a propagated field of the place gains, µT², shape (3, 3).

        `place` (3,) is the field in µT, body axes, `turned` (3,) the radians by which the robot has
        turned, `faster` (3,) the rad/s by which the turn rate has grown, and `way` the metres that
        the magnetometer has gone, zero at rest.
        """
        lost = self.turn_error**2 * math.sqrt(float(turned @ turned))
        lost += self.latency**2 * float(faster @ faster)
        lost += self.walk**2 * seconds if way > 0.0 else 0.0
        passed = 2.0 * self.street**2 * way / self.street_length + self.passing**2 * seconds
        return np.asarray(
            (lost * float(place @ place) + passed) * EYE - lost * place[:, None] * place
        )


PLACE_FIELD = PlaceFieldTuning()


class _Answer(NamedTuple):
    """What a sample shows if the motors may add so much that no input shows."""

    likelihood: float
    step: FloatArray
    covariance: FloatArray
    left: FloatArray
    doubt: FloatArray


class MotorsNow:
    """Follows the field of the place and what is left of the motors' field.

    `matrix` (3, 3) is from the magnetometer's axes to those of the body, and `noise` (3, 3) the
    covariance of a corrected sample, tesla². `iron_variance` is that of the corrected field per
    axis by the calibration's own uncertainty, tesla²: that part does not turn as the field of the
    place does.
    """

    def __init__(
        self, motors: MotorField, matrix: FloatArray, iron_variance: float, noise: FloatArray
    ) -> None:
        self._matrix = matrix
        self._iron = iron_variance * MICROTESLA**2
        self._noise = noise * MICROTESLA**2 + 1e-4 * EYE
        self._mean, self._covariance = np.zeros(6), np.zeros((6, 6))
        self._rate, self._before = np.zeros(3), AT_REST
        self._stamp, self._late_since = -math.inf, math.nan
        self._values = self._change = np.zeros(0)
        self.use(motors)

    def use(self, motors: MotorField) -> None:
        """Take what is known of the motors from now on."""
        count = len(motors.inputs)
        self._motors = motors
        self._gains = motors.gain @ self._matrix.T * MICROTESLA
        turn = np.kron(np.eye(count), self._matrix) * MICROTESLA
        by_gains = turn @ motors.covariance @ turn.T
        self._by_gains = by_gains.reshape(count, 3, count, 3).transpose(1, 3, 0, 2)
        self._ripple = (motors.ripple * MICROTESLA) ** 2
        usual = self._gains * np.array(motors.usual)[:, None]
        self._whole = usual.T @ usual
        most = self._whole + self._level(Running(1.0), np.array(motors.usual))
        # Motors that a sample's own noise hides are not worth the time.
        self._is_felt = bool(np.trace(most) > np.trace(self._noise))
        late = (MotorInput.SPEED, MotorInput.CURRENT, MotorInput.ABS_SPEED)
        self._latency = np.array([RUNNING.latency * (each in late) for each in motors.inputs])
        if len(self._values) != count:
            self._values, self._change = np.zeros(count), np.zeros(count)

    def add(
        self, stamp: float, field: Triple, rate: Triple | None, running: Running
    ) -> tuple[Triple, FloatArray]:
        """Take a corrected sample; returns it less K u and what is left, and the latter's doubt.

        `field` is in tesla, body axes, `rate` in rad/s, less the gyro's bias, None without a gyro.
        Returns a field likewise, and the covariance (3, 3) of what was subtracted, tesla².
        """
        if running.moving == 0.0 and (not self._is_felt or rate is None):
            return field, np.zeros((3, 3))
        values, doubt = self._motors.known(running)
        if not self._is_felt or rate is None:
            return self._by_inputs(field, running, values, doubt)
        self._predict(stamp, rate, running, values)
        known = values @ self._gains
        measured = MICROTESLA * np.array(field) - known
        change = np.diag(np.square(self._latency * self._change))
        unknown = self._gains.T @ (doubt + change) @ self._gains
        otherwise = known[:, None] * known if running.moving > 0.0 else self._whole
        answers = [self._answer(measured, unknown + each) for each in (0.0, otherwise)]
        late = self._late(stamp, answers[1].likelihood - answers[0].likelihood)
        if late is None:
            # What lasts is no start or stop: another motor, or at rest another place.
            self._forget(PLACE if running.moving == 0.0 else LEFT, self._whole + otherwise)
            answers, late = [self._answer(measured, unknown)] * 2, 0.0
        one, other = answers
        self._mean = self._mean + one.step + late * (other.step - one.step)
        self._covariance = _mixed(late, one.covariance, other.covariance, other.step - one.step)
        left = one.left + late * (other.left - one.left)
        spread = _mixed(late, one.doubt, other.doubt, other.left - one.left)
        x, y, z = ((measured - left) / MICROTESLA).tolist()
        return (x, y, z), spread / MICROTESLA**2

    def _by_inputs(
        self, field: Triple, running: Running, values: FloatArray, doubt: FloatArray
    ) -> tuple[Triple, FloatArray]:
        """Return a sample less K u alone: what samples cannot show need not be followed."""
        x, y, z = (values @ self._gains / MICROTESLA).tolist()
        spread = self._level(running, values) + self._gains.T @ doubt @ self._gains
        return (field[0] - x, field[1] - y, field[2] - z), spread / MICROTESLA**2

    def _level(self, running: Running, values: FloatArray) -> FloatArray:
        """Return the covariance of what motors add beside K u, µT²."""
        by_gains = (self._by_gains @ values) @ values
        known = RUNNING.unseen * (values @ self._gains)
        return np.asarray(running.moving * self._ripple * EYE + by_gains + known[:, None] * known)

    def _late(self, stamp: float, odds: float) -> float | None:
        """Return the probability that motors run otherwise than is seen; None if that lasts."""
        share = RUNNING.late_share
        late = share / (share + (1.0 - share) * math.exp(min(-odds, 300.0)))
        if late < 0.5:
            self._late_since = math.nan
        elif math.isnan(self._late_since):
            self._late_since = stamp
        elif stamp - self._late_since > RUNNING.longest:
            self._late_since = math.nan
            return None
        return late

    def _answer(self, measured: FloatArray, unknown: FloatArray) -> _Answer:
        mean, covariance = self._mean, self._covariance
        off = measured - mean[PLACE] - mean[LEFT]
        both = covariance[:, PLACE] + covariance[:, LEFT]
        inverse = np.linalg.inv(both[PLACE] + both[LEFT] + unknown + self._noise)
        gain = both @ inverse
        left = both[LEFT] + unknown
        seen = left @ inverse
        return _Answer(
            0.5 * (math.log(np.linalg.det(inverse)) - float(off @ inverse @ off)),
            gain @ off,
            covariance - gain @ both.T,
            mean[LEFT] + seen @ off,
            covariance[LEFT, LEFT] + unknown - seen @ left.T,
        )

    def _predict(self, stamp: float, rate: Triple, running: Running, values: FloatArray) -> None:
        seconds, self._stamp = stamp - self._stamp, stamp
        moves, moved = running.moving > 0.0, self._before.moving > 0.0
        level = self._level(running, values)
        now = np.array(rate)
        changed, self._values = values - self._values, values
        faster, self._rate, self._before = now - self._rate, now, running
        if not 0.0 < seconds < PLACE_FIELD.longest:
            self._forget(PLACE, level)
            self._forget(LEFT, level)
            self._change = np.zeros(len(values))
            return
        share = min(seconds / RUNNING.latency, 1.0)
        self._change = self._change + share * (changed / seconds - self._change)
        turned = seconds * moves * (now - 0.5 * faster)
        keeps = math.exp(-seconds / RUNNING.body_length) if moves and moved else 0.0
        step = np.zeros((6, 6))
        step[PLACE, PLACE], step[LEFT, LEFT] = exp_rotation(-turned), keeps * EYE
        self._mean = step @ self._mean
        covariance = step @ self._covariance @ step.T
        way = seconds * moves * PLACE_FIELD.way(running.speed, rate)
        covariance[PLACE, PLACE] += (
            PLACE_FIELD.change(self._mean[PLACE], turned, faster, way, seconds)
            + self._iron * math.sqrt(float(turned @ turned)) * EYE
        )
        # So large that in the latency it changes by as much as the inputs do.
        late = 0.5 * RUNNING.body_length / RUNNING.latency * self._latency**2
        level = level + self._gains.T @ np.diag(late * self._change**2) @ self._gains
        covariance[LEFT, LEFT] += (1.0 - keeps**2) * level
        covariance[LEFT, LEFT] += keeps**2 * (self._by_gains @ changed) @ changed
        self._covariance = covariance

    def _forget(self, which: slice, level: FloatArray) -> None:
        """Begin anew with a place of which nothing is known, or with motors of such a size."""
        self._mean[which] = 0.0
        self._covariance[which] = self._covariance[:, which] = 0.0
        self._covariance[which, which] = PLACE_FIELD.field**2 * EYE if which is PLACE else level


def _mixed(share: float, one: FloatArray, other: FloatArray, apart: FloatArray) -> FloatArray:
    """Return the covariance of a mixture of two, whose means are so far apart."""
    spread = one + share * (other - one) + share * (1.0 - share) * apart[:, None] * apart
    return np.asarray(0.5 * (spread + spread.T))
