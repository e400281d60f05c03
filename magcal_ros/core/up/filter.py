"""A Kalman filter of up, gyro bias and velocity, and the tuning of all estimates of up.

While a robot accelerates, brakes or circles, its accelerometer does not measure up. The gyro
propagates up meanwhile, but drifts. Up is constant in the world; the velocity changes slowly in the
body. The centripetal acceleration of a steady circle, turn rate x velocity, is therefore modelled
for any time; other accelerations are short.

Accelerations and lengths of the specific force are in standard gravity, g.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit
from magcal_ros.core.geometry.rotations import IDENTITY, exp_rotation, skew
from magcal_ros.core.geometry.vec3 import Triple, length
from magcal_ros.core.knowledge import CLEAR


@dataclass(frozen=True)
class FilterTuning:
    """The Kalman filter on up, gyro bias, velocity and linear acceleration."""

    bias_sigma: float = 0.006
    """Prior of the gyro's bias, rad/s per axis. Cheap gyros reach 0.09 (5°/s), which is learnt at
    the first rest."""
    seen_at_rest: float = 0.002  # sigma of the bias about up that needs a rest, rad/s
    largest_bias: float = 0.16  # rad/s, length of any estimate: 5°/s on each axis, and a little
    angle_walk: float = 3e-4
    turn_error: float = 0.003
    """As of `GyroTuning`, smaller: with the values of a yaw, up of a hand-held sensor is worse."""
    hidden_walk: float = 4e-3
    """Random walk of up where axes of the gyro are dead, radians per root second: within a minute,
    the slope of a road changes by 1 to 2°."""
    usual_acceleration: float = 0.1  # g, sigma per axis of a moving robot
    usual_speed: float = 4.0  # m/s, sigma per axis, for the centripetal acceleration
    right: float = 0.95  # prior probability that a measured acceleration is right
    right_lasts: float = 30.0  # seconds for which it stays right or wrong, on the average
    freedom: float = 4.0  # degrees of freedom of its error, a Student distribution
    acceleration_lasts: float = 2.0
    """Correlation time of an acceleration, and of the sway of a rolling robot, seconds: vehicles
    accelerate for 2 to 5 s."""
    speed_lasts: float = 20.0  # correlation time, seconds: from street corner to street corner
    floor: float = 2e-3
    """g. Error of the accelerometer that no averaging removes, and least acceleration of a robot at
    rest or in steady motion."""
    rest_length_sigma: float = 0.02  # g, prior sigma of the accelerometer's length at rest


@dataclass(frozen=True)
class GyroTuning:
    """The errors of a gyro's angle, and of its bias."""

    angle_walk: float = 1e-3  # random walk of the angle, radians per root second
    turn_error: float = 0.005  # relative error of a turn, per root radian
    bias_walk: float = 1.8e-5
    walk_spread: float = 1.0
    """Random walk of the bias, rad/s per root second: median, and standard deviation of the natural
    logarithm. Cheap gyros drift by .001 to .01 °/s in a minute."""

    def walk_variance(self, turned: float, seconds: float) -> float:
        """Return the growth of the variance of an angle, rad², by a turn in radians."""
        return self.angle_walk**2 * seconds + self.turn_error**2 * abs(turned)

    @property
    def usual_bias_walk(self) -> float:
        """Root mean square of the random walk of the bias, rad/s per root second."""
        return self.bias_walk * math.exp(self.walk_spread**2)


@dataclass(frozen=True)
class RestTuning:
    """When the robot counts as resting, so that the accelerometer measures up."""

    doubtful_rate: float = 0.01
    """rad/s. A constant rate above this, beyond the known bias, may be a turn."""
    sure: float = 7.0
    """Log odds from which a steady force points up: 3 (95%), as accelerations are far more frequent
    than rests at the beginning of a steady force (prior log odds of -4)."""
    constant_for: float = 0.18
    """Seconds: in each such time, a constant acceleration ends with a probability of 63%."""
    loose: float = 0.0025  # g, largest change of a steady force in addition to noise
    loose_rate: float = 0.005  # rad/s, the same
    alike: float = 2.0  # sigmas of the noise that are allowed in addition
    length_floor: float = 3e-4  # g, least sigma of the accelerometer's length at rest
    level_share: float = 0.05
    """Least fraction of the raw field that rotates with the robot: a turn by an angle changes the
    field by more than this fraction of the angle."""
    field_mean: float = 0.25  # seconds over which the field is averaged before it is compared
    shaken_force: float = 0.007
    shaken_field: float = 0.012
    """Largest deviations of means over a second, from the mean of a rest, while an engine shakes
    the robot: g, and fraction of the raw field. The first is also the sigma of up then."""
    shaken_sigma: float = math.radians(0.1)  # rad/s per axis across up, least sigma of its bias


@dataclass(frozen=True)
class PropagationTuning:
    """How messages are gathered for the filter, and up without a gyro."""

    block: float = 0.04  # seconds of messages in one update of the filter
    memory: float = 1.0  # seconds over which noise, scatter and length are measured
    starting_noise: float = 0.01  # g per axis, before it is measured
    starting_rate_noise: float = 0.005  # the same, rad/s
    smallest: float = 1e-3
    """Least sigma of up, radians; g of the accelerometer's length that are ignored without a
    gyro."""
    smoothing: float = 0.15  # seconds over which up is smoothed without a gyro
    rest_memory: float = 30.0  # seconds over which the length at rest is learnt without a gyro


@dataclass(frozen=True)
class GyroCheckTuning:
    """When a gyro counts as mirrored or dead."""

    span: float = 0.4
    """Longest time over which force and turn are averaged before they are compared, seconds: two
    periods of an engine's shaking at 5 Hz, and less than half a nod."""
    memory: float = 20.0  # seconds of evidence that are kept
    enough: float = 0.01  # g, root of the summed squared changes: a nod by 6°
    clear_noise: float = 10.0
    """Variances of the gyro's noise that the squared changes must exceed as well; an engine shakes
    by more than the measured noise."""
    dead: int = 100  # messages with noise on another axis after which a constant axis is dead
    near_up: float = 0.7  # least part of up along working axes: within 45° of up


FILTER, GYRO, REST, PROPAGATION, CHECK = (
    FilterTuning(),
    GyroTuning(),
    RestTuning(),
    PropagationTuning(),
    GyroCheckTuning(),
)
USUAL_SPEED = FILTER.usual_speed / STANDARD_GRAVITY  # g s


class UpFilter:
    """A Kalman filter on up (g), gyro bias (rad/s), velocity (g s) and acceleration (g), body axes.

    The accelerometer measures up + acceleration + turn rate x velocity. Up is a vector of any
    length: the model is linear, and the length absorbs a scale error of the accelerometer. Velocity
    and acceleration are Ornstein-Uhlenbeck processes; the `acceleration` of a method is the sigma
    of the present one, g per axis.
    """

    def __init__(self) -> None:
        self.state: FloatArray = np.zeros(12)
        self.covariance: FloatArray = np.zeros((12, 12))
        self.covariance[3:6, 3:6] = IDENTITY * FILTER.bias_sigma**2

    @property
    def up(self) -> FloatArray:
        """Up, g, shape (3,)."""
        return self.state[:3]

    @property
    def tilt_variance(self) -> float:
        """Variance of the direction of up, rad², the mean of its two directions."""
        own = self.covariance[:3, :3]
        across = float(np.trace(own)) - self._along_up(own)
        return max(0.0, across) / (2.0 * float(self.up @ self.up))

    @property
    def bias_variance(self) -> float:
        """Variance of the bias about up, (rad/s)²."""
        return max(0.0, self._along_up(self.covariance[3:6, 3:6]))

    def _along_up(self, covariance: FloatArray) -> float:
        """Return the variance along up by a covariance (3, 3)."""
        return float(self.up @ covariance @ self.up) / float(self.up @ self.up)

    def begin(self, force: FloatArray, variance: float, rate: float, acceleration: float) -> None:
        """Start from one accelerometer reading (g), and keep the estimate of the bias."""
        own = self.covariance[3:6, 3:6].copy()
        self.state[:3], self.state[6:] = force, 0.0
        self.covariance[:] = 0.0
        self.covariance[3:6, 3:6] = own
        # Up is the force without both accelerations.
        less = -np.hstack([skew(rate * unit(force)), IDENTITY])
        prior = np.repeat([USUAL_SPEED**2, acceleration**2], 3)
        self.covariance[6:, 6:] = np.diag(prior)
        self.covariance[:3, 6:] = shared = less * prior
        self.covariance[6:, :3] = shared.T
        self.covariance[:3, :3] = shared @ less.T + IDENTITY * variance

    def forget_acceleration(self) -> None:
        """Reset the linear acceleration to that of a moving robot."""
        self.covariance[9:] = self.covariance[:, 9:] = 0.0
        self.covariance[9:, 9:] = IDENTITY * FILTER.usual_acceleration**2
        self.state[9:] = 0.0

    def predict(
        self,
        up: Triple,
        turned: Triple,
        seconds: float,
        acceleration: float,
        walk: float,
    ) -> None:
        """Propagate the state over a block of messages.

        `up` is up after the block, propagated by the gyro without its bias, `turned` the rotation
        vector of the body, radians, body axes, and `walk` the random walk of its error, rad/√s.
        """
        step = np.eye(12)
        fast = math.exp(-seconds / FILTER.speed_lasts)
        kept = math.exp(-seconds / FILTER.acceleration_lasts)
        step[:3, :3] = exp_rotation(-np.array(turned))
        step[:3, 3:6] = -skew(seconds * np.array(up))
        step.reshape(-1)[78::13] = (fast, fast, fast, kept, kept, kept)
        self.state[:3] = up
        self.state[6:9] *= fast
        self.state[9:] *= kept
        grown = walk**2 * seconds + FILTER.turn_error**2 * length(turned)
        found = length(self.state[9:].tolist())
        if found > CLEAR * math.sqrt(3.0) * acceleration:
            # A wrong up looks like an acceleration; it is forgotten as soon as one ends.
            grown += found**2 * seconds / FILTER.acceleration_lasts
        p = step @ self.covariance @ step.T
        walked = GYRO.usual_bias_walk**2 * seconds
        sped = USUAL_SPEED**2 * (1.0 - fast**2)
        shoved = acceleration**2 * (1.0 - kept**2)
        p.reshape(-1)[::13] += (*(grown,) * 3, *(walked,) * 3, *(sped,) * 3, *(shoved,) * 3)
        self.covariance = p

    def observe_force(self, innovation: FloatArray, variance: float, rate: float) -> None:
        """Update with the mean innovation of a block: the accelerometer minus propagated up.

        `innovation` (3,) and the `variance` of its noise are in g and g². `rate` is the turn rate
        about up, rad/s. Roll and pitch rates are left out: they are shaking, in phase with that of
        the accelerometer.
        """
        reads = np.eye(3, 12)
        reads[:, 6:9] = skew(self.up * (rate / length(self.up.tolist())))
        reads[:, 9:] = IDENTITY
        left = innovation - reads[:, 6:] @ self.state[6:]
        self._correct(reads, variance + FILTER.floor**2, left)

    def observe_up(self, innovation: FloatArray, variance: float) -> None:
        """Update with up as a measured acceleration gives it, minus the propagated one, g."""
        self._correct(np.eye(3, 12), variance, innovation)

    def observe_bias(self, rate: FloatArray, variance: float, axis: FloatArray | None) -> None:
        """Update with the mean rate of a block without a turn.

        `rate` (3,) is in rad/s, `variance` of its noise in (rad/s)². `axis` is a unit vector about
        which the robot may turn, if any.
        """
        shown = IDENTITY if axis is None else IDENTITY - np.outer(axis, axis)
        reads = np.zeros((3, 12))
        reads[:, 3:6] = shown
        self._correct(reads, variance, shown @ (rate - self.state[3:6]))

    def replace_bias_across_up(self, rate: FloatArray, covariance: FloatArray) -> bool:
        """Replace the bias across up by another estimate if that is more certain.

        `rate` (3,) is in rad/s, `covariance` (3, 3) in (rad/s)². Up and velocity follow the bias as
        they are correlated with it. The other estimate contains the same samples, so it is not an
        independent measurement. Returns whether the bias was replaced.
        """
        reads = np.zeros((2, 12))
        reads[:, 3:6] = across = np.linalg.svd(self.state[None, :3])[2][1:]
        own, new = reads @ self.covariance @ reads.T, across @ covariance @ across.T
        is_better = bool(np.trace(new) < np.trace(own))
        if is_better:
            follow = np.linalg.solve(own, reads @ self.covariance).T
            self.state += follow @ (across @ rate - reads @ self.state)
            self.covariance += follow @ (new - own) @ follow.T
        return is_better

    def admit_bias(self, rate: FloatArray) -> None:
        """Widen the covariance of the bias if a measured one is far outside it."""
        gap, own = rate - self.state[3:6], self.covariance[3:6, 3:6]
        if float(gap @ gap) > CLEAR**2 * float(np.trace(own)):
            own += IDENTITY * float(gap @ gap)

    def _correct(self, reads: FloatArray, variance: float, innovation: FloatArray) -> None:
        """Update with three measurements; `reads` (3, 12) is their measurement matrix."""
        rows = reads @ self.covariance
        gain = rows.T @ np.linalg.inv(reads @ rows.T + variance * IDENTITY)
        self.state += gain @ innovation
        p = self.covariance - gain @ rows
        self.covariance = 0.5 * (p + p.T)
