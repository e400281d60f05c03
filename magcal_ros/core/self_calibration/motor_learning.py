"""The field of the motors, learnt while a robot drives: at starts, stops and turns.

The states of a Kalman filter, in body axes, are the field of the place, the error of the hard iron,
coloured noise of the body, and the motors' gains, one vector for each input. The gyro propagates
the field of the place, which is forgotten within some metres: the gains are determined by changes
of the inputs and not of the place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import INPUTS, MotorField, MotorInput, MotorState
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray
from magcal_ros.core.geometry.rotations import exp_rotation
from magcal_ros.core.geometry.vec3 import Triple, scaled
from magcal_ros.core.heading.heading_tuning import FUSION, MOTION, PLACE_FIELD
from magcal_ros.core.heading.motor_field_filter import ODDS, STREET
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.self_calibration.self_calibration_tuning import LEARNING

MICROTESLA = 1e6
PACE = PLACE_FIELD.block / FUSION.moving_tau
"""Weight of a block in the averages of noise and inputs."""
USUAL_STREET = float(ODDS @ STREET**2)
"""Mean square of the local disturbance, µT² per axis."""
PLACE, IRON, BODY = slice(0, 3), slice(3, 6), slice(6, 9)
FIXED = 9
"""States before the gains: field of the place, error of the hard iron, coloured noise; µT."""
GAINS = slice(FIXED, FIXED + 3 * len(INPUTS))
LATE = GAINS.stop
"""State: latency of the current, seconds."""
CURRENT = INPUTS.index(MotorInput.CURRENT)


USUAL_SIZES = np.array([1.0, 0.5, 0.5, 2.0, 1.0, 0.5, 0.5])
"""Size of each of `INPUTS` while a robot moves, until it is known: rad/s, m/s, A."""


@dataclass(frozen=True, eq=False)
class _Interval:
    """Means over some samples, and rotation and path of the robot."""

    count: int
    seconds: float
    path: float  # metres
    clear: bool  # whether the motors neither started nor stopped
    turned: FloatArray  # rotation vector at the end, and its mean, radians
    mean_turned: FloatArray
    field: FloatArray  # raw, tesla
    inputs: FloatArray


class MotorLearning:
    """Learns the motors' gains from successive samples."""

    def __init__(self, calibration: Calibration) -> None:
        self._calibration = calibration
        self._white = (calibration.noise_field * MICROTESLA) ** 2
        size = LATE + 1
        self._mean = np.zeros(size)
        self._prior_mean, self._prior, self._known = _beginning(calibration)
        self._used = self._known  # which inputs have been measured, or are in the calibration
        self._covariance = np.zeros((size, size))
        rows = np.r_[IRON, GAINS]
        self._covariance[np.ix_(rows, rows)] = self._prior
        self._mean[GAINS] = self._prior_mean[3:]
        usual = 0.5 * MOTION.latency
        self._mean[LATE], self._covariance[LATE, LATE] = usual, usual**2
        motors = calibration.motors
        ripple = LEARNING.body if motors is None else motors.ripple * MICROTESLA
        self._ripple = max(ripple, LEARNING.body)
        self._reference = math.nan if motors is None else motors.reference
        self._squares = USUAL_SIZES**2
        if motors is not None:
            for each, usual in zip(motors.inputs, motors.usual, strict=True):
                self._squares[INPUTS.index(each)] = max(usual, 1e-3) ** 2
        self._rows: list[tuple[float, ...]] = []
        """Stamp, duration, path, whether it is clear, rotation, raw field and inputs."""
        self._before: _Interval | None = None
        self._was_clear = True
        self._moving = 0.0
        self._left = self._rate = np.zeros(3)
        self._stamp = -math.inf
        self._forget_place()

    def add(self, stamp: float, raw: Triple, rate: Triple, motor_state: MotorState) -> bool:
        """Add a raw field sample; return whether a block is complete.

        The stamp is in seconds, `raw` in tesla in the magnetometer's axes, `rate` in rad/s in body
        axes without the gyro's bias, and `motor_state` are the inputs of the motors' field.
        """
        seconds, self._stamp = stamp - self._stamp, stamp
        if not 0.0 < seconds < STREAMS.longest_field_gap:
            self._forget_place()
            self._rows, self._before = [], None
            return False
        moving, moves = motor_state.moving, motor_state.moving > 0.0
        is_clear = moving == self._moving and moving in (0.0, 1.0)
        self._moving = moving
        path = seconds * moves * PLACE_FIELD.path(motor_state.speed, rate)
        # A robot at rest has a gyro's noise, and no turn.
        turn = scaled(rate, seconds) if moves else (0.0, 0.0, 0.0)
        self._rows.append((stamp, seconds, path, is_clear, *turn, *raw, *motor_state.values))
        if stamp - self._rows[0][0] < PLACE_FIELD.block:
            return False
        rows, self._rows = np.array(self._rows), []
        count, means = len(rows), rows.mean(axis=0)
        turned = np.cumsum(rows[:, 4:7], axis=0)
        block = _Interval(
            count,
            seconds=float(count * means[1]),
            path=float(count * means[2]),
            clear=bool(means[3] == 1.0),
            turned=turned[-1],
            mean_turned=turned.mean(axis=0),
            field=means[7:10],
            inputs=means[10:],
        )
        # Sensors and motors have latency: next to a start or stop no block is clear.
        before, self._before = self._before, block
        if before is not None:
            self._take(before, block, self._was_clear and block.clear)
            self._was_clear = before.clear
        return True

    @property
    def motors(self) -> MotorField:
        """The present estimate; the gain of an input that explains nothing is near zero."""
        which = np.flatnonzero(self._used)
        rows = _rows(which)
        here, prior_mean = np.r_[IRON, GAINS][rows], self._prior_mean[rows]
        prior = np.linalg.inv(self._prior[np.ix_(rows, rows)])
        now = np.linalg.inv(self._covariance[np.ix_(here, here)])
        weighted = now @ self._mean[here] - prior @ prior_mean
        # The prior of a gain that the calibration does not contain has the mean zero.
        known = np.isin(rows, _rows(np.flatnonzero(self._known)))
        believed = np.where(np.outer(known, known), prior, 0.0)
        seen = _GainPosterior(_positive(now - prior), weighted + believed @ prior_mean, believed)
        covariance, mean, _ = seen.posterior(self._scales(seen, which))
        return self._in_sensor_axes(covariance, mean, which)

    @property
    def delay(self) -> tuple[float, float]:
        """Latency of the current, and its standard deviation, seconds."""
        return float(self._mean[LATE]), math.sqrt(self._covariance[LATE, LATE])

    def _scales(self, seen: _GainPosterior, which: IntArray) -> FloatArray:
        """Return the prior sigmas of gains that the calibration does not contain, µT per unit.

        Each is the root mean square under the posterior of the size (`Unknown`), one input after
        the other.
        """
        grid = LEARNING.usual * np.exp(LEARNING.spread * np.linspace(-2.0, 3.2, 14))
        grid = grid[grid < LEARNING.most]
        belief = -0.5 * (np.log(grid / LEARNING.usual) / LEARNING.spread) ** 2
        scales, usual = np.full(len(seen.weighted), math.inf), np.sqrt(self._squares[which])
        by_input, free = scales[3:].reshape(-1, 3), np.flatnonzero(~self._known[which])
        by_input[free] = LEARNING.usual / usual[free, None]
        for row in np.tile(free, 2):
            odds = belief.copy()
            for i, size in enumerate(grid):
                by_input[row] = size / usual[row]
                odds[i] += seen.posterior(scales)[2]
            odds = np.exp(odds - odds.max())
            by_input[row] = math.sqrt(float(odds @ grid**2 / odds.sum())) / usual[row]
        return scales

    def _in_sensor_axes(
        self, covariance: FloatArray, mean: FloatArray, which: IntArray
    ) -> MotorField:
        """Return the gains, given the hard iron of the calibration in force."""
        calibration, count = self._calibration, len(which)
        back = np.linalg.inv(calibration.correction.matrix)
        gain = np.linalg.solve(covariance[:3, :3], covariance[:3, 3:]).T
        own = covariance[3:, 3:] - gain @ covariance[:3, 3:]
        found = mean[3:] - gain @ mean[:3]
        turn = np.kron(np.eye(count), back)
        by_iron = turn @ gain @ calibration.correction.matrix
        cross_covariance = calibration.covariance[:, 9:] @ by_iron.T
        whole = turn @ own @ turn.T / MICROTESLA**2
        whole = whole + by_iron @ calibration.covariance[9:, 9:] @ by_iron.T
        return MotorField(
            tuple(INPUTS[k] for k in which),
            (turn @ found).reshape(-1, 3) / MICROTESLA,
            0.5 * (whole + whole.T),
            cross_covariance,
            self._ripple / MICROTESLA,
            tuple(np.sqrt(self._squares[which]).tolist()),
            self._reference,
        )

    def _forget_place(self) -> None:
        """Reset the field of the place to its prior."""
        for at in (PLACE, BODY):
            self._mean[at] = 0.0
            self._covariance[at, :] = self._covariance[:, at] = 0.0
        self._covariance[PLACE, PLACE] = PLACE_FIELD.field**2 * np.eye(3)
        self._covariance[BODY, BODY] = LEARNING.body**2 * np.eye(3)

    def _take(self, block: _Interval, after: _Interval, is_even: bool) -> None:
        """Propagate over a block and update with its means, but not next to a start or stop."""
        known = ~np.isnan(block.inputs)
        self._used = self._used | known
        u = np.where(known, block.inputs, 0.0)
        moves = u[0] > 0.0
        self._predict(block, moves)
        # At rest all inputs are zero, also silent ones; except the current that holds a robot.
        is_known = known[CURRENT] or math.isnan(self._reference)
        if moves:
            is_known = known[self._used].all()
        if not (is_known and block.clear and is_even):
            return
        y = self._calibration.correction.apply(block.field) * MICROTESLA
        later = after.inputs[CURRENT] - u[CURRENT]
        faster = later / block.seconds if known[CURRENT] and math.isfinite(later) else 0.0
        u[CURRENT] += self._mean[LATE] * faster
        gain = self._mean[GAINS].reshape(-1, 3)[CURRENT]
        h = np.column_stack([np.kron([1.0, 1.0, 1.0, *u], np.eye(3)), faster * gain])
        noise = self._white / block.count + 1e-4
        p_h = self._covariance @ h.T
        spread = h @ p_h + noise * np.eye(3)
        # The last column is the derivative by the current's latency.
        off = y - h[:, :LATE] @ self._mean[:LATE]
        square = float(off @ np.linalg.solve(spread, off))
        weight = (LEARNING.freedom + 3.0) / (LEARNING.freedom + square)
        # Outliers have less weight; a large step that the gains may explain is no outlier.
        gain = min(weight, 1.0) * np.linalg.solve(spread, p_h.T).T
        self._mean += gain @ off
        self._covariance -= gain @ p_h.T
        self._covariance = 0.5 * (self._covariance + self._covariance.T)
        if moves:
            self._squares += PACE * (np.where(known, u**2, self._squares) - self._squares)
            step = PACE * (min(square / 3.0, 4.0) - 1.0)
            self._ripple = min(max(self._ripple * math.exp(step), LEARNING.body), LEARNING.most)

    def _predict(self, block: _Interval, moves: bool) -> None:
        path, seconds = block.path, block.seconds
        # From the middle of the block before to the middle of this one.
        turned = self._left + block.mean_turned
        rate = block.turned / seconds
        faster, self._rate = rate - self._rate, rate
        self._left = block.turned - block.mean_turned
        step = np.eye(len(self._mean))
        correlation = math.exp(-seconds / MOTION.body_length)
        step[PLACE, PLACE] = exp_rotation(-turned)
        step[BODY, BODY] = correlation * np.eye(3)
        self._mean = step @ self._mean
        self._covariance = step @ self._covariance @ step.T
        place = self._mean[PLACE]
        self._covariance[PLACE, PLACE] += PLACE_FIELD.change(place, turned, faster, path, seconds)
        path_variance = USUAL_STREET * PLACE_FIELD.path_variance(path)
        self._covariance[PLACE, PLACE] += path_variance * np.eye(3)
        level = self._ripple if moves else LEARNING.body
        self._covariance[BODY, BODY] += level**2 * (1.0 - correlation**2) * np.eye(3)
        self._covariance[IRON, IRON] += LEARNING.iron_walk**2 * seconds * np.eye(3)


def _beginning(calibration: Calibration) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return prior mean and covariance of hard iron and gains (µT), and which are known."""
    matrix = calibration.correction.matrix
    size = 3 + 3 * len(INPUTS)
    mean, sigmas = np.zeros(size), np.repeat(LEARNING.most / USUAL_SIZES, 3)
    covariance = np.diag(np.r_[0.0, 0.0, 0.0, sigmas**2])
    covariance[:3, :3] = matrix @ calibration.covariance[9:, 9:] @ matrix.T * MICROTESLA**2
    motors, known = calibration.motors, np.zeros(len(INPUTS), dtype=np.bool_)
    if motors is not None:
        places = [INPUTS.index(each) for each in motors.inputs]
        known[places], rows = True, _rows(places)
        turn = np.kron(np.eye(1 + len(places)), matrix)
        joint = motors.joint(calibration.covariance)[9:, 9:]
        covariance[np.ix_(rows, rows)] = turn @ joint @ turn.T * MICROTESLA**2
        mean[rows[3:]] = (motors.gain @ matrix.T).ravel() * MICROTESLA
        step = INPUTS.index(MotorInput.MOVING)
        if known[step] and not known[CURRENT]:
            # The step found in the turn may have been the field of a current.
            at = slice(3 + 3 * step, 6 + 3 * step)
            whole = np.array(motors.usual) @ motors.gain @ matrix.T * MICROTESLA
            covariance[at, at] += np.outer(whole, whole)
    # Files may contain exact numbers; a filter needs a positive covariance.
    return mean, covariance + 1e-6 * np.eye(size), known


def _rows(inputs: Sequence[int] | IntArray) -> IntArray:
    """Return the rows of the iron's error and of the gains of some inputs."""
    gains = [3 + 3 * k + np.arange(3) for k in inputs]
    return np.concatenate([np.arange(3), *gains])


def _positive(matrix: FloatArray) -> FloatArray:
    """Return the nearest matrix without negative eigenvalues."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


@dataclass(frozen=True, eq=False)
class _GainPosterior:
    """The likelihood of the iron's error and the gains, and the prior of the known numbers."""

    shown: FloatArray  # information of the samples, shape (m, m)
    weighted: FloatArray  # information times mean, of samples and prior together, shape (m,)
    prior: FloatArray  # information of the prior, zero for the other numbers, shape (m, m)

    def posterior(self, scales: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """Return covariance, mean and log evidence under prior sigmas of the other numbers.

        `scales` (m,) is infinite for the known numbers. The evidence is up to a constant.
        """
        information = self.prior + np.diag(scales**-2)
        both = self.shown + information
        covariance = np.linalg.inv(both)
        mean = covariance @ self.weighted
        cost = np.linalg.slogdet(both)[1] - np.linalg.slogdet(information)[1]
        evidence = 0.5 * float(self.weighted @ mean - cost)
        return 0.5 * (covariance + covariance.T), mean, evidence
