"""The assumptions of the up filter: each number with its unit and its reason.

Accelerations and lengths of the specific force are counted in standard gravity, g.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

CLEAR = 3.0
"""Sigmas beyond which a deviation is no chance."""


@dataclass(frozen=True)
class FilterTuning:
    """The Kalman filter on up, gyro bias, velocity and linear acceleration."""

    bias_sigma: float = 0.006
    """rad/s per axis. A gyro's bias before it was seen at rest; cheap gyros reach 0.09 (5°/s),
    which is learnt as soon as the robot rests."""
    seen_at_rest: float = 0.002
    """rad/s. A bias about up that is known so well was seen at rest: nothing else shows it."""
    bias_walk: float = 1e-4  # rad/s per root second
    largest_bias: float = 0.16
    """rad/s. No estimate of the bias may be longer: 5°/s on each axis, and a little."""
    angle_walk: float = 3e-4  # radians per root second: what a gyro loses while it does not turn
    turn_error: float = 0.003
    """Share of a turn that scale and axes of the gyro get wrong, per root radian."""
    usual_acceleration: float = 0.1  # g, sigma per axis of a robot under way
    usual_speed: float = 4.0
    """m/s, sigma per axis. A turn at this speed accelerates sideways by speed times turn rate."""
    given_acceleration: float = 0.03
    given_speed: float = 0.5
    """g and m/s. What of both is left where the linear acceleration is given and subtracted."""
    acceleration_lasts: float = 2.0
    """Seconds. Vehicles speed up and brake for 2 to 5 s, and roughness of the way is shorter."""
    speed_lasts: float = 20.0  # seconds, from street corner to street corner
    floor: float = 2e-3
    """g. Error of an averaged accelerometer reading that no averaging removes, and the least
    acceleration of a robot that stands or rolls steadily."""
    regain: float = 3.0  # seconds in which an up that was wrong is given up
    rest_length_sigma: float = 0.02
    """g about one. What an accelerometer reads at rest, before it was seen at rest."""


@dataclass(frozen=True)
class RestTuning:
    """When the robot is taken to rest, so that the accelerometer shows up."""

    largest_rate: float = 0.035
    """rad/s. A steady gyro that reads more than this beyond its known bias may be turning; less is
    taken for bias while no field is there to decide."""
    doubtful_rate: float = 0.01  # rad/s, the same where there is a field
    lasting: float = 4.0
    """Seconds of steadiness after which there is no linear acceleration, although the length shows
    one."""
    undecided: float = 1.0
    """The same where the length shows nothing, and seconds of a settled spell from which bias and
    length at rest are learnt."""
    agreeing: float = 0.5
    """The same where moreover the accelerometer points to where up was propagated."""
    agrees: float = 0.01  # radians between the two, and g of a shaken rest's mean force
    shortest: float = 0.1  # the same as `lasting` where the length excludes an acceleration
    loose: float = 0.0025
    loose_rate: float = 0.005
    """g and rad/s. A change of both that is still called steady, beside the noise."""
    alike: float = 2.0  # sigmas of the noise that are called steady besides
    length_floor: float = 3e-4  # g, how well the accelerometer's length is known at best
    sways: float = 2.0  # seconds after which a robot that rolls sways to the other side
    level_share: float = 0.05
    """Share of the raw field that turns with the robot, at the least: a turn by an angle changes
    the field by more than this share of the angle."""
    field_mean: float = 0.25  # seconds over which the field is averaged before it is compared
    field_lasts: float = 1.0  # seconds after which the last field says nothing
    shaken: int = 4
    """Averages over a second that must agree for a rest of a robot whose engine shakes it."""
    shaken_force: float = 0.007
    shaken_rate: float = math.radians(0.5)
    shaken_field: float = 0.012
    """g, rad/s and share of the raw field by which each average may be off their mean."""
    shaken_sigma: float = math.radians(0.1)  # rad/s per axis across up, of the bias at least


@dataclass(frozen=True)
class PropagationTuning:
    """How messages are gathered for the filter, and up without a gyro."""

    block: float = 0.04  # seconds of messages that the filter takes together
    memory: float = 1.0  # seconds over which noise, scatter and length are measured
    starting_noise: float = 0.01
    starting_rate_noise: float = 0.005
    """g and rad/s per axis, before they are measured."""
    smallest: float = 1e-3
    """Sigma of up, radians, that no filter removes; g by which an accelerometer's length on the
    way, or without a gyro, differs from that at rest."""
    most_turning: int = 500
    """Messages of a turning robot over which its accelerometer's length is averaged."""
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
    enough: float = 0.01
    """g. Root of the summed squared changes, as of a nod by 6°, before anything is decided."""
    clear_noise: float = 10.0
    """How many times the gyro's noise those changes must be besides; an engine's shaking is more
    than what is measured as noise."""
    mirrored: float = -0.3
    """How much of the turns a gyro gets right: all is one, the acceleration in a circle adds
    nothing, and a mirrored one gets them right with the wrong sign."""
    dead: int = 100
    """Messages with noise on another axis after which one that never changed is dead."""
    bend: float = 1e-4  # share of a rate by which noise bends it from message to message


FILTER, REST, PROPAGATION, CHECK = (
    FilterTuning(),
    RestTuning(),
    PropagationTuning(),
    GyroCheckTuning(),
)
