"""The assumptions of the up filter: each number with its unit and its reason.

Accelerations and lengths of the specific force are counted in standard gravity, g.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True)
class FilterTuning:
    """The Kalman filter on up, gyro bias, velocity and linear acceleration."""

    unknown: float = 1.0
    """g. Sigma of an up of which nothing is known."""
    bias_sigma: float = 0.006
    """rad/s per axis. A gyro's bias before it was seen at rest; cheap gyros reach 0.09 (5°/s),
    which is learnt as soon as the robot rests."""
    seen_at_rest: float = 0.002
    """rad/s. A bias about up that is known so well was seen at rest: nothing else shows it."""
    bias_walk: float = 1e-4
    """rad/s per root second."""
    largest_bias: float = 0.16
    """rad/s. No estimate of the bias may be longer: 5°/s on each axis, and a little."""
    angle_walk: float = 3e-4
    """Radians per root second: what a gyro loses while it does not turn."""
    turn_error: float = 0.003
    """Share of a turn that scale and axes of the gyro get wrong, per root radian."""
    usual_acceleration: float = 0.1
    """g. What a robot under way must be thought capable of."""
    usual_speed: float = 4.0
    """m/s, sigma per axis. A turn at this speed accelerates sideways by speed times turn rate."""
    given_acceleration: float = 0.03
    given_speed: float = 0.5
    """g and m/s. What of both is left where the linear acceleration is given and taken off."""
    acceleration_lasts: float = 2.0
    """Seconds. Vehicles speed up and brake for 2 to 5 s, and roughness of the way is shorter."""
    speed_lasts: float = 20.0
    """Seconds. From street corner to street corner."""
    steady_acceleration: float = 2e-3
    """g. Of a robot that stands or rolls steadily, at the least; what is not at rest hides about as
    much as its force scatters."""
    floor: float = 2e-3
    """g. Error of an averaged accelerometer reading that no averaging takes away."""
    implausible: float = 3.0
    """Sigmas of linear acceleration beyond which rather up is wrong, and of the gyro's bias beyond
    which it was not known."""
    regain: float = 3.0
    """Seconds in which an up that was wrong is given up."""
    rest_length: float = 1.0
    rest_length_sigma: float = 0.02
    """g. What an accelerometer reads at rest, before it was seen at rest."""


@dataclass(frozen=True)
class RestTuning:
    """When the accelerometer may be believed."""

    largest_rate: float = 0.035
    """rad/s. A steady gyro that reads more than this beyond its known bias may be turning; while
    there is no field to tell, less is taken for bias."""
    doubtful_rate: float = 0.01
    """rad/s. The same where there is a field to tell."""
    lasting: float = 4.0
    """Seconds of steadiness after which there is no linear acceleration, although the length speaks
    for one."""
    undecided: float = 1.0
    """The same where the length says nothing."""
    agreeing: float = 0.5
    """The same where moreover the accelerometer points to where up was propagated."""
    agrees: float = 0.01
    """Radians between the two."""
    shortest: float = 0.1
    """The same as `lasting` where the length speaks against an acceleration."""
    loose: float = 0.0025
    loose_rate: float = 0.005
    """g and rad/s. A change of both that is still called steady, beside the noise."""
    alike: float = 2.0
    """Sigmas of the noise that are called steady besides."""
    clear: float = 3.0
    """Sigmas beyond which something else is shown."""
    length_floor: float = 3e-4
    """g. How well the accelerometer's length is known at best."""
    known: float = 1.0
    """Seconds of a settled spell from which bias and length at rest are learnt."""
    sways: float = 2.0
    """Seconds after which a robot that rolls sways to the other side."""
    level_share: float = 0.05
    """Share of the raw field that turns with the robot, at the least: a turn by an angle changes
    the field by more than this share of the angle."""
    field_mean: float = 0.25
    """Seconds over which the field is averaged before it is compared."""
    field_lasts: float = 1.0
    """Seconds after which a field that came no more says nothing."""


@dataclass(frozen=True)
class ShakenRestTuning:
    """When a robot stands although its engine shakes it."""

    span: float = 1.0
    spans: int = 4
    """Seconds that are averaged, and how many averages must agree."""
    force: float = 0.007
    rate: float = math.radians(0.5)
    """g and rad/s by which each may be off their mean."""
    field: float = 0.012
    """The same of the raw field, as a share of it."""
    sigma: float = math.radians(0.1)
    """rad/s per axis across up, of the bias at the least."""
    up: float = 0.01
    """g, of the mean force as up."""


@dataclass(frozen=True)
class PropagationTuning:
    """How messages are gathered for the filter."""

    block: float = 0.04
    """Seconds of messages that the filter takes together."""
    noise_memory: float = 1.0
    """Seconds over which the noise of accelerometer and gyro is measured."""
    starting_noise: float = 0.01
    starting_rate_noise: float = 0.005
    """g and rad/s per axis, before they are measured."""
    smallest: float = 1e-3
    """Sigma of up, radians, that no filter takes away."""
    most_turning: int = 500
    """Messages of a turning robot over which its accelerometer's length is averaged."""
    turning_sigma: float = 1e-3
    """g. How well that length is the length at rest."""
    turn_lasts: float = 2.0
    """Seconds over which the turn rate of a vehicle is averaged; steering changes it more
    slowly."""


@dataclass(frozen=True)
class GyroCheckTuning:
    """When a gyro is called mirrored."""

    span: float = 0.4
    """Seconds over which force and turn are averaged at most before they are compared: two periods
    of an engine's shaking at 5 Hz, and less than half a nod."""
    clear_turn: float = 5.0
    """Sigmas of the gyro's noise beyond which a turn is compared at once."""
    memory: float = 20.0
    """Seconds of which the evidence is kept."""
    enough: float = 0.01
    """g. Root of the summed squared changes, as of a nod by 6°, before anything is said."""
    clear_noise: float = 10.0
    """How many times the gyro's noise those changes must be besides; an engine's shaking is more
    than what is measured as noise."""
    mirrored: float = -0.3
    """How much of the turns a gyro gets right: all is one, the acceleration in a circle adds
    nothing, and a mirrored one gets them right with the wrong sign."""
    clear: float = 3.0
    """Sigmas."""
    dead: int = 100
    """Messages with noise on another axis after which one that never changed is dead."""
    bend: float = 1e-4
    """Share of a rate by which noise bends it from message to message."""


@dataclass(frozen=True)
class LevellingTuning:
    """Up from the accelerometer alone."""

    smoothing: float = 0.15
    """Seconds."""
    memory: float = 1.0
    """Seconds over which scatter and length are watched."""
    rest_memory: float = 30.0
    """Seconds over which the length at rest is learnt."""
    floor: float = 2e-3
    """Radians."""
    length_floor: float = 1e-3
    """g. Departure from the length at rest that says nothing."""


@dataclass(frozen=True)
class UpTuning:
    """All of them; the defaults suit ground robots and cars with a MEMS sensor."""

    filter: FilterTuning = field(default_factory=FilterTuning)
    rest: RestTuning = field(default_factory=RestTuning)
    shaken: ShakenRestTuning = field(default_factory=ShakenRestTuning)
    propagation: PropagationTuning = field(default_factory=PropagationTuning)
    check: GyroCheckTuning = field(default_factory=GyroCheckTuning)
    levelling: LevellingTuning = field(default_factory=LevellingTuning)
