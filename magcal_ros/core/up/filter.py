"""Up, gyro bias and the robot's velocity, estimated together, and all assumptions about up.

The accelerometer of a robot that speeds up, brakes or circles points away from up. The gyro
propagates up through this, but drifts. What separates them: up stays where it is in the world,
the velocity where it is in the body: in a steady circle it is accelerated by turn rate x velocity
for however long, and what is left is soon over.

Accelerations and lengths of the specific force are counted in standard gravity, g.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import exp_rotation
from magcal_ros.core.geometry.vec3 import Triple, length
from magcal_ros.core.knowledge import CLEAR


@dataclass(frozen=True)
class FilterTuning:
    """The Kalman filter on up, gyro bias, velocity and linear acceleration."""

    bias_sigma: float = 0.006
    """rad/s per axis. A gyro's bias before it was seen at rest; cheap gyros reach 0.09 (5°/s),
    which is learnt as soon as the robot rests."""
    seen_at_rest: float = 0.002  # rad/s of sigma about up, which only a rest can show
    bias_walk: float = 1e-4  # rad/s per root second
    largest_bias: float = 0.16  # rad/s, length of any estimate: 5°/s on each axis, and a little
    angle_walk: float = 3e-4  # radians per root second: what a gyro loses while it does not turn
    turn_error: float = 0.003  # share of a turn that a gyro gets wrong, per root radian
    usual_acceleration: float = 0.1  # g, sigma per axis of a robot under way
    usual_speed: float = 4.0
    """m/s, sigma per axis. A turn at this speed accelerates sideways by speed times turn rate."""
    given_acceleration: float = 0.03  # g that is left where the acceleration is measured
    given_speed: float = 0.5  # the same, m/s
    acceleration_lasts: float = 2.0  # seconds: vehicles speed up and brake for 2 to 5 s
    speed_lasts: float = 20.0  # seconds, from street corner to street corner
    floor: float = 2e-3
    """g. Error of an averaged accelerometer reading that no averaging removes, and the least
    acceleration of a robot that stands or rolls steadily."""
    regain: float = 3.0  # seconds in which an up that was wrong is given up
    rest_length_sigma: float = 0.02  # g about one, before it was seen at rest


@dataclass(frozen=True)
class RestTuning:
    """When the robot is taken to rest, so that the accelerometer shows up."""

    largest_rate: float = 0.035
    """rad/s. A steady gyro that reads more than this beyond its known bias may be turning; less is
    taken for bias while no field is there to decide."""
    doubtful_rate: float = 0.01  # rad/s, the same where there is a field
    lasting: float = 4.0  # seconds of steadiness after which no length speaks against it
    undecided: float = 1.0
    """The same where the length shows nothing, and seconds of a settled spell from which bias and
    length at rest are learnt."""
    agreeing: float = 0.5  # the same where the force points to where up was propagated
    agrees: float = 0.01  # radians between the two, and g of a shaken rest's mean force
    shortest: float = 0.1  # the same as `lasting` where the length excludes an acceleration
    loose: float = 0.0025  # g of a change that is called steady, beside the noise
    loose_rate: float = 0.005  # the same, rad/s
    alike: float = 2.0  # sigmas of the noise that are called steady besides
    length_floor: float = 3e-4  # g, how well the accelerometer's length is known at best
    sways: float = 2.0  # seconds after which a robot that rolls sways to the other side
    level_share: float = 0.05
    """Share of the raw field that turns with the robot, at the least: a turn by an angle changes
    the field by more than this share of the angle."""
    field_mean: float = 0.25  # seconds over which the field is averaged before it is compared
    field_lasts: float = 1.0  # seconds after which the last field says nothing
    shaken_force: float = 0.007
    shaken_field: float = 0.012
    """g and share of the raw field by which each second of a rest may be off the mean of some of
    them, where an engine shakes the robot."""
    shaken_sigma: float = math.radians(0.1)  # rad/s per axis across up, of the bias at least


@dataclass(frozen=True)
class PropagationTuning:
    """How messages are gathered for the filter, and up without a gyro."""

    block: float = 0.04  # seconds of messages that the filter takes together
    memory: float = 1.0  # seconds over which noise, scatter and length are measured
    starting_noise: float = 0.01  # g per axis, before it is measured
    starting_rate_noise: float = 0.005  # the same, rad/s
    smallest: float = 1e-3
    """Sigma of up, radians, that no filter removes; g by which an accelerometer's length without a
    gyro differs from that at rest."""
    smoothing: float = 0.15  # seconds over which up is smoothed without a gyro
    rest_memory: float = 30.0  # seconds over which the length at rest is learnt without a gyro


@dataclass(frozen=True)
class GyroCheckTuning:
    """When a gyro is called mirrored or dead."""

    span: float = 0.4
    """Seconds over which force and turn are averaged at most before they are compared: two periods
    of an engine's shaking at 5 Hz, and less than half a nod."""
    clear_turn: float = 5.0  # sigmas of the gyro's noise from which a turn is compared at once
    memory: float = 20.0  # seconds of which the evidence is kept
    enough: float = 0.01  # g, root of the summed squared changes: as of a nod by 6°
    clear_noise: float = 10.0
    """How many times the gyro's noise those changes must be besides; an engine's shaking is more
    than what is measured as noise."""
    mirrored: float = -0.3
    """How much of the turns a gyro gets right: all is one, the acceleration in a circle adds
    nothing, and a mirrored one gets them right with the wrong sign."""
    dead: int = 100  # messages with noise on another axis after which an axis is dead
    bend: float = 1e-4  # share of a rate by which noise bends it from message to message


FILTER, REST, PROPAGATION, CHECK = (
    FilterTuning(),
    RestTuning(),
    PropagationTuning(),
    GyroCheckTuning(),
)
IDENTITY: FloatArray = np.eye(3)


class MotionPrior(NamedTuple):
    """How fast a robot may be (g s), and how it may speed up and brake (g): sigmas per axis."""

    speed: float
    acceleration: float


class UpFilter:
    """A Kalman filter on up (g), gyro bias (rad/s), velocity (g s) and acceleration (g), body axes.

    The accelerometer reads up + acceleration + turn rate x velocity. Up is a vector of any
    length, so that the model is linear and a scale error of the accelerometer is taken up by the
    length of up. Velocity and acceleration are Ornstein-Uhlenbeck processes of the sizes of a
    `MotionPrior`.
    """

    def __init__(self) -> None:
        self.state: FloatArray = np.zeros(12)
        self.covariance: FloatArray = np.zeros((12, 12))
        self.covariance[3:6, 3:6] = IDENTITY * FILTER.bias_sigma**2
        self._transition = np.eye(12)
        self._reads: FloatArray = np.hstack([IDENTITY, np.zeros((3, 6)), IDENTITY])

    @property
    def up(self) -> FloatArray:
        """Up over gravity, shape (3,)."""
        return self.state[:3]

    @property
    def tilt_variance(self) -> float:
        """Variance of the direction of up, rad², the mean of its two directions."""
        _, across, square = self._by_up(0)
        return max(0.0, across) / (2.0 * square) if square > 0.0 else 1.0

    @property
    def bias_variance(self) -> float:
        """Variance of the bias about up, (rad/s)²."""
        along, across, square = self._by_up(3)
        return max(0.0, along) if square > 0.0 else across

    def _by_up(self, first: int) -> Triple:
        """Return the variance of three unknowns along up and across it, and the square of up."""
        x, y, z = self.state[:3].tolist()
        own = self.covariance[first : first + 3, first : first + 3]
        (a, b, c), (_, d, e), (_, _, f) = own.tolist()
        square = x * x + y * y + z * z
        along = a * x * x + d * y * y + f * z * z + 2.0 * (b * x * y + c * x * z + e * y * z)
        along = along / square if square > 0.0 else 0.0
        return (along, a + d + f - along, square)

    def begin(self, force: FloatArray, variance: float, rate: float, motion: MotionPrior) -> None:
        """Start from one accelerometer reading (over gravity); what is known of the bias stays."""
        own = self.covariance[3:6, 3:6].copy()
        turning = _sideways(force.tolist(), rate)
        self.covariance[:] = 0.0
        self.covariance[3:6, 3:6] = own
        self.covariance[6:9, 6:9] = IDENTITY * motion.speed**2
        self.covariance[9:, 9:] = IDENTITY * motion.acceleration**2
        moved = np.hstack([turning * motion.speed**2, IDENTITY * motion.acceleration**2])
        self.covariance[:3, 6:], self.covariance[6:, :3] = -moved, -moved.T
        self.covariance[:3, :3] = moved[:, :3] @ turning.T + moved[:, 3:] + IDENTITY * variance
        self.state[:3], self.state[6:] = force, 0.0

    def forget_motion(self, motion: MotionPrior, is_faster: bool = False) -> None:
        """Allow for another linear acceleration from now on; for another speed if `is_faster`."""
        first = 6 if is_faster else 9
        self.covariance[first:] = self.covariance[:, first:] = 0.0
        self.state[first:] = 0.0
        sigmas = (motion.speed,) * 3 + (motion.acceleration,) * 3
        self.covariance[range(first, 12), range(first, 12)] = np.square(sigmas[first - 6 :])

    def predict(self, up: Triple, turned: Triple, seconds: float, motion: MotionPrior) -> None:
        """Go on by a block of messages.

        `up` is up after the block, propagated by the gyro less its bias, `turned` the radians that
        the body turned by in body axes, and `motion` how the robot may move.
        """
        step = self._transition
        fast = math.exp(-seconds / FILTER.speed_lasts)
        kept = math.exp(-seconds / FILTER.acceleration_lasts)
        step[:3, :3] = exp_rotation(-np.array(turned))
        x, y, z = (seconds * each for each in up)
        step[:3, 3:6] = ((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0))
        step.reshape(-1)[78::13] = (fast, fast, fast, kept, kept, kept)
        self.state[:3] = up
        self.state[6:9] *= fast
        self.state[9:] *= kept
        grown = FILTER.angle_walk**2 * seconds + FILTER.turn_error**2 * length(turned)
        acceleration = length(self.state[9:].tolist())
        if acceleration > CLEAR * math.sqrt(3.0) * motion.acceleration:
            grown += acceleration**2 * seconds / FILTER.regain
        p = step @ self.covariance @ step.T
        walked = FILTER.bias_walk**2 * seconds
        sped = motion.speed**2 * (1.0 - fast**2)
        shoved = motion.acceleration**2 * (1.0 - kept**2)
        p.reshape(-1)[::13] += [each for each in (grown, walked, sped, shoved) for _ in range(3)]
        self.covariance = p

    def observe_force(self, innovation: FloatArray, variance: float, rate: float) -> None:
        """Take the mean of accelerometer less propagated up over a block, and its variance.

        `innovation` (3,) and the `variance` of its noise are in g and g². `rate` is that of the
        turn about up meanwhile, rad/s. Rolling and pitching are shaking rather than turning, and an
        engine shakes sensor and seat in one time.
        """
        reads = self._reads
        reads[:, 6:9] = _sideways(self.state[:3].tolist(), rate)
        left = innovation - reads[:, 6:] @ self.state[6:]
        self._correct(reads, variance + FILTER.floor**2, left)

    def observe_length(self, size: float, variance: float) -> None:
        """Take what the accelerometer reads at rest, over gravity."""
        up = self.state[:3]
        own = length(up.tolist())
        if own > 0.0:
            gain_rows = self.covariance[:, :3] @ (up / own)
            spread = float(gain_rows[:3] @ up) / own + variance
            self.state += gain_rows * ((size - own) / spread)
            self.covariance -= gain_rows[:, None] * (gain_rows / spread)

    def observe_bias(self, rate: FloatArray, variance: float, axis: FloatArray | None) -> None:
        """Take the mean rate of a block of a robot that does not turn.

        `rate` (3,) is in rad/s, `variance` of its noise in (rad/s)². `axis` is the unit vector
        about which the robot may turn all the same, where there is one.
        """
        shown = IDENTITY if axis is None else IDENTITY - np.outer(axis, axis)
        reads = np.zeros((3, 12))
        reads[:, 3:6] = shown
        self._correct(reads, variance, shown @ (rate - self.state[3:6]))

    def admit_bias(self, rate: FloatArray) -> None:
        """Allow for a bias that lies further off than what was known of it."""
        gap, own = rate - self.state[3:6], self.covariance[3:6, 3:6]
        if float(gap @ gap) > CLEAR**2 * float(np.trace(own)):
            own += IDENTITY * float(gap @ gap)

    def _correct(self, reads: FloatArray, variance: float, innovation: FloatArray) -> None:
        """Take three readings that differ from what was expected, and how they read the state."""
        rows = reads @ self.covariance
        (a, b, c), (_, d, e), (_, _, f) = (reads @ rows.T).tolist()
        a, d, f = a + variance, d + variance, f + variance
        p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
        s, t, u = a * f - c * c, b * c - a * e, a * d - b * b
        inverse = np.array([[p, q, r], [q, s, t], [r, t, u]]) / (a * p + b * q + c * r)
        gain = rows.T @ inverse
        self.state += gain @ innovation
        p = self.covariance - gain @ rows
        self.covariance = 0.5 * (p + p.T)


def _sideways(up: Triple, rate: float) -> FloatArray:
    """Return what makes of a velocity its acceleration in a turn about up at a rate in rad/s."""
    size = length(up)
    x, y, z = (rate / size * each for each in up) if size > 0.0 else (0.0, 0.0, 0.0)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
