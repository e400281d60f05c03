"""Propagation of up by the gyro from message to message; the filter runs once per block."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magcal_ros.core.calibration.calibration import FittedGyroBias
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit
from magcal_ros.core.geometry.vec3 import (
    Triple,
    distance,
    dot,
    interpolate,
    length,
    minus,
    plus,
    propagated,
    scaled,
    unit_triple,
)
from magcal_ros.core.knowledge import CLEAR
from magcal_ros.core.up.filter import FILTER, PROPAGATION, REST, USUAL_SPEED, UpFilter
from magcal_ros.core.up.stillness import (
    ZERO,
    BlockMeans,
    FieldStillness,
    GyroCheck,
    ShakenRest,
    SteadyInterval,
)


class GyroBias(NamedTuple):
    """A gyro's bias, rad/s, body axes, and the variance of its part about up, (rad/s)².

    `at_rest` is the mean rate of the newest messages, rad/s, body axes, and the variance of its
    noise, (rad/s)², where they show that the robot does not turn.
    """

    rate: Triple
    variance: float
    at_rest: tuple[Triple, float] | None = None


class LinearAcceleration(NamedTuple):
    """A measured acceleration of the robot, body axes: with a speed v, (dv/dt, v w_z, 0)."""

    vector: Triple  # m/s²
    sigma: float  # per axis, m/s²
    lasts: float  # correlation time of its error, seconds


class MeasuredAcceleration:
    """The probability that the measured acceleration is right: it stays so or not for some time.

    A right one has errors of a Student distribution. A wrong one differs from the true acceleration
    by as much as two accelerations do. Both are compared by the angle, the `gap`, between up by the
    measured acceleration and another estimate of up, radians; `variance` is that of the gap per
    axis.
    """

    def __init__(self) -> None:
        self.right = FILTER.right

    def add(self, gap: float, variance: float, seconds: float, count: float) -> None:
        """Compare with the filter's up over some seconds with so many independent errors."""
        ratio = min(1.0, count) * self._log_ratio(gap, variance)
        right = self.right / (self.right + (1.0 - self.right) * math.exp(-ratio))
        self.right = right + min(1.0, seconds / FILTER.right_lasts) * (FILTER.right - right)

    def weight(self, gap: float, variance: float) -> float:
        """Return the weight of the measured acceleration, from zero to one."""
        return self.right / (1.0 + gap * gap / (FILTER.freedom * variance))

    def evidence_of_rest(self, gap: float, variance: float) -> float:
        """Return the log likelihood ratio of a force that points up, against an acceleration.

        The gap is that between the force and up by the measured acceleration. An acceleration may
        be smaller than the error of the measured one, so the ratio is not above zero.
        """
        odds = math.exp(min(0.0, self._log_ratio(gap, variance)))
        return math.log(self.right * odds + 1.0 - self.right)

    @staticmethod
    def _log_ratio(gap: float, variance: float) -> float:
        """Return the log likelihood ratio of a right measurement against a wrong one."""
        square, wrong = gap * gap, variance + 2.0 * FILTER.usual_acceleration**2
        tail = 0.5 * FILTER.freedom + 1.0
        off = tail * math.log1p(square / (FILTER.freedom * variance))
        return math.log(wrong / variance) - off + 0.5 * square / wrong


class GyroPropagation:
    """Propagates up by the gyro, and corrects it by the accelerometer where the motion allows.

    `up` is in g, with the length that the accelerometer measures at rest. `mean_rate` is the rate
    since the previous message, without the bias, rad/s. `is_settled` is whether the accelerometer
    measures up: at rest or in steady motion.
    """

    def __init__(self) -> None:
        self.up = self.bias = ZERO
        self.variance = math.inf  # of up in either direction, rad²
        self.tilt_is_hidden = False  # whether the rate is that about up alone
        self.check = GyroCheck()
        self.field = FieldStillness()  # takes the raw field, where there is one
        self._shaken = ShakenRest()
        self._filter = UpFilter()
        self._noise = PROPAGATION.starting_noise**2
        self._rate_noise = PROPAGATION.starting_rate_noise**2
        self._rest, self._rest_sigma = 1.0, FILTER.rest_length_sigma
        self._at_rest: tuple[Triple, float] | None = None
        self._measured = MeasuredAcceleration()
        self._up_by_measured: tuple[Triple, float] | None = None
        self.begin(0.0, (0.0, 0.0, 1.0), ZERO)

    def begin(self, stamp: float, force: Triple, rate: Triple) -> None:
        """Start again from a force in g, and keep the gyro's bias."""
        self.up = force
        self._stamp, self._force, self._rate = stamp, force, rate
        self.mean_rate = ZERO
        self._begin_block()
        self._steady = SteadyInterval()
        self.field.begin()
        self._shaken.forget()
        self._is_still = self.is_settled = False
        self.check.restart()
        turning = self._steady_turn = self._turn_rate(self.rate)
        self._filter.begin(np.array(force), self._noise, turning, FILTER.usual_acceleration)
        self._take_over()

    @property
    def rate(self) -> Triple:
        """The newest turn rate minus the bias, rad/s."""
        return minus(self._rate, self.bias)

    def add(
        self,
        stamp: float,
        force: Triple,
        rate: Triple,
        seconds: float,
        measured: LinearAcceleration | None = None,
    ) -> None:
        """Add force (g), rate and measured acceleration, `seconds` after the previous ones."""
        before, old = self._rate, self._force
        self._stamp, self._rate, self._force = stamp, rate, force
        self.mean_rate = minus(interpolate(before, rate, 0.5), self.bias)
        turn = scaled(self.mean_rate, seconds)
        self.up = propagated(self.up, turn)
        self._block.append((force, self.up, rate, turn))
        self._seconds += seconds
        if measured is not None:
            own = scaled(measured.vector, 1.0 / STANDARD_GRAVITY)
            self._accelerations.append((measured, minus(minus(force, own), self.up)))
        if self._seconds >= PROPAGATION.block:
            self._measure_noise(distance(force, old), distance(rate, before), self._seconds)
            self._end()
            self._begin_block()

    def _begin_block(self) -> None:
        """Begin a block of messages, over which the filter runs at its end.

        Each message has a force (g), the propagated up, rate (rad/s) and turn (radians). Those with
        a measured acceleration have also the force without it minus the propagated up.
        """
        self._block: list[tuple[Triple, Triple, Triple, Triple]] = []
        self._accelerations: list[tuple[LinearAcceleration, Triple]] = []
        self._seconds = 0.0

    def take_bias(self, fitted: FittedGyroBias) -> None:
        """Use the bias of a fit across up, unless the filter's own estimate is more certain."""
        if not self.tilt_is_hidden and self._filter.replace_bias_across_up(*fitted):
            self._take_over()

    def _measure_noise(self, force: float, rate: float, seconds: float) -> None:
        """Update the noise with the differences of two messages."""
        share = min(1.0, seconds / PROPAGATION.memory)
        # Half the square of a difference is the variance; jumps are limited.
        smallest = PROPAGATION.smallest**2
        square = min(force * force / 6.0, 10.0 * self._noise + smallest)
        self._noise += share * (square - self._noise)
        square = min(rate * rate / 6.0, 10.0 * self._rate_noise + smallest)
        self._rate_noise += share * (square - self._rate_noise)

    def _end(self) -> None:
        """Run the filter over a block."""
        following, noise = self._filter, math.sqrt(self._noise)
        count, seconds = len(self._block), self._seconds
        sums = np.sum(self._block, axis=0)
        force, up, rate = (sums[:3] / count).tolist()
        turn: Triple = tuple(sums[3].tolist())
        means = BlockMeans(tuple(force), tuple(rate), count, seconds)
        self._at_rest = None
        self.check.add(means.force, turn, seconds, self._rate_noise * seconds**2 / count)
        goes_on = self._steady.add(means, noise, math.sqrt(self._rate_noise))
        if not goes_on:
            self.field.begin()
            self._is_still = False
        ambiguous_rate = self._ambiguous_rate()
        is_steady = self.is_settled and ambiguous_rate is not None
        acceleration = self._steady_acceleration if is_steady else FILTER.usual_acceleration
        walk = FILTER.hidden_walk if self.tilt_is_hidden else FILTER.angle_walk
        following.predict(self.up, turn, seconds, acceleration, walk)
        if self.is_settled and (ambiguous_rate is None or not goes_on):
            self.is_settled = False
            following.forget_acceleration()
        # An average: noise of the rate times the velocity would look like an acceleration.
        share = min(1.0, seconds / FILTER.acceleration_lasts)
        newest = self._turn_rate(turn) / seconds
        self._steady_turn += share * (newest - self._steady_turn)
        turning = 0.0 if ambiguous_rate == 0.0 else self._steady_turn
        following.observe_force(np.subtract(force, up), self._noise / count, turning)
        self._up_by_measured = None
        if self._accelerations:
            self._observe_measured()
        if not self.is_settled:
            self._settle(ambiguous_rate, noise)
        elif self._steady.seconds > PROPAGATION.memory:
            self._learn(means, ambiguous_rate, noise)
        self._look_for_shaken_rest(means)
        self._take_over()

    def _observe_measured(self) -> None:
        """Correct up by the measured acceleration, as far as that is probably right."""
        following, measured, given = self._filter, self._measured, len(self._accelerations)
        newest = self._accelerations[-1][0]
        error = (newest.sigma / STANDARD_GRAVITY) ** 2 + FILTER.floor**2
        seconds = self._seconds * given / len(self._block)
        off = np.sum([each for _, each in self._accelerations], axis=0) / given
        up_by_measured = plus(self.up, tuple(off.tolist()))
        own: Triple = tuple(following.up.tolist())
        if length(up_by_measured) <= 0.0 or length(own) <= 0.0:
            return
        self._up_by_measured = unit_triple(up_by_measured), error
        gap = distance(self._up_by_measured[0], unit_triple(own))
        variance = error + following.tilt_variance
        independent = seconds / (2.0 * newest.lasts)
        measured.add(gap, variance, seconds, independent)
        # White noise of the same density has the same effect on a slow estimate.
        white = error / independent / max(measured.weight(gap, variance), 1e-3)
        following.observe_up(np.array(minus(up_by_measured, own)), white)

    def _ambiguous_rate(self) -> float | None:
        """Return the rate (rad/s) that may be turn or bias: zero at rest, None in a turn."""
        interval = self._steady
        if length(interval.rate) > FILTER.largest_bias:
            return None
        excess = minus(interval.rate, self.bias)
        size = length(interval.force)
        about = abs(dot(excess, interval.force)) / size if size > 0.0 else length(excess)
        if self._is_still or about < REST.doubtful_rate:
            return 0.0
        if not self.field.is_recent(self._stamp):
            return about
        has_turned = self.field.has_turned(about)
        if has_turned is None:
            return about
        # A constant rate that has been identified as bias remains so during the interval.
        self._is_still = not has_turned
        return 0.0 if self._is_still else None

    def _learn(self, means: BlockMeans, ambiguous_rate: float | None, noise: float) -> None:
        """Learn the bias and the accelerometer's length from a robot at rest."""
        interval = self._steady
        axis = None if ambiguous_rate == 0.0 else np.array(unit_triple(interval.force))
        white = self._rate_noise / means.messages
        # A rolling robot sways more slowly than a block: the mean of a block still contains sway.
        sway = max(0.0, interval.sway - white) * FILTER.acceleration_lasts / means.seconds
        self._filter.observe_bias(np.array(means.rate), white + sway, axis)
        self._at_rest = (means.rate, white + sway) if axis is None else None
        self._rest = length(interval.force)
        self._rest_sigma = math.hypot(REST.length_floor, noise / math.sqrt(interval.count))

    def _look_for_shaken_rest(self, means: BlockMeans) -> None:
        """Learn bias and up from a robot that an engine shakes at rest."""
        if not self.field.is_recent(self._stamp):
            self._shaken.forget()
            return
        shown, following = self._shaken.add(means, self.field.mean), self._filter
        if shown is None or self.is_settled:
            return
        force, rate, variance = shown
        if float(np.linalg.norm(rate)) > FILTER.largest_bias:
            return
        # A slow turn about up could change the field by no more than passing vehicles do.
        following.admit_bias(rate)
        following.observe_bias(rate, variance, unit(force))
        if float(np.linalg.norm(unit(force) - unit(following.up))) > CLEAR * REST.shaken_force:
            following.begin(force, REST.shaken_force**2, 0.0, self._steady_acceleration)
            following.forget_acceleration()

    def _settle(self, ambiguous_rate: float | None, noise: float) -> None:
        """Use the accelerometer once it is steady for long enough, or its length shows a rest."""
        interval, following = self._steady, self._filter
        if ambiguous_rate is None:
            return
        # Variance of the accelerations that a steady robot may hide, compared with that of up.
        acceleration = self._steady_acceleration
        hidden = acceleration**2 + (USUAL_SPEED * ambiguous_rate) ** 2
        tilt_variance = following.tilt_variance
        if ambiguous_rate and tilt_variance <= hidden:
            return
        up: Triple = tuple(following.up.tolist())
        evidence = interval.evidence(up, tilt_variance, (self._rest, self._rest_sigma), noise)
        if evidence > -math.inf and self._up_by_measured is not None:
            up_by_measured, variance = self._up_by_measured
            gap = distance(unit_triple(interval.force), up_by_measured)
            evidence += self._measured.evidence_of_rest(gap, variance)
        if evidence + interval.seconds / REST.constant_for < REST.sure:
            return
        self.is_settled = True
        # A jump of up that the gyro does not show may be a long, constant acceleration.
        jump = distance(unit_triple(interval.force), unit_triple(up))
        jump /= math.sqrt(1.0 + math.exp(min(evidence, 300.0)))
        variance = self._noise / interval.count + FILTER.floor**2
        acceleration = math.hypot(acceleration, jump)
        following.begin(np.array(interval.force), variance, ambiguous_rate, acceleration)

    def _turn_rate(self, rate: Triple) -> float:
        """Return the part about up of a rate without its bias."""
        size = length(self.up)
        return dot(rate, self.up) / size if size > 0.0 else 0.0

    @property
    def _steady_acceleration(self) -> float:
        """Prior sigma of the acceleration in steady motion, g per axis."""
        return max(FILTER.floor, math.sqrt(self._steady.shake))

    def _take_over(self) -> None:
        x, y, z, p, q, r = self._filter.state[:6].tolist()
        self.up, self.bias = (x, y, z), (p, q, r)
        size = length(self.bias)
        if size > FILTER.largest_bias:
            self._filter.state[3:6] *= FILTER.largest_bias / size
        self.variance = self._filter.tilt_variance + PROPAGATION.smallest**2
        self.gyro_bias = GyroBias(self.bias, self._filter.bias_variance, self._at_rest)
