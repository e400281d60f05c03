"""The assumptions about turns and known headings: each number with its unit and its reason."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class SessionTuning:
    """Size of the buffer, and conditions for a complete turn."""

    largest_buffer: int = 20_000
    """Pairs. A full buffer is thinned to equal angles, or to equal times if the angles are unknown,
    so that its size is bounded."""
    enough_for_progress: int = 2_000
    """Rows beyond which progress uses only every second, third ... row, because it is computed ten
    times a second in the thread of the messages."""
    most_turns: float = 2.0  # full turns after which a turn ends in any case
    near: float = 2.0
    """Ratio of the predicted sigma to the target up to which a turn ends at `once_more`. Beyond it
    a local disturbance is likely, and a second round is useful."""
    once_more: float = 1.2  # full turns at which a turn ends if the target is not reached
    rest: float = 3.0
    """Seconds at rest that end a complete turn, that come before the turn of a robot which turns
    itself (for the gyro's bias and the motors' field), and of a mean at a known heading."""
    slowest_turn: float = math.radians(3.0)  # rad/s below which the robot is at rest
    preview_arc: float = math.radians(120.0)  # arc for the first predicted sigma, radians
    preview_share: float = 0.25  # fraction of one core that predictions may use


@dataclass(frozen=True)
class RotationTuning:
    """Commands of a turn, faults of the robot, and the test of the gyro by the field."""

    acceleration: float = 0.5  # rad/s² of the ramps
    pause: float = 0.5  # seconds at rest between the two directions
    longest_step: float = 0.2  # longest time step of a ramp, seconds, also after a longer delay
    least_share: float = 0.3  # fraction of the commanded rate that is due in spite of wheel slip
    most_share: float = 1.75  # fastest rate in multiples of the planned speed
    off_by_gyro: float = math.radians(15.0)
    off_by_compass: float = math.radians(40.0)
    """Radians by which the measured angle may be behind what is due, or ahead of the fastest turn.
    A base starts late; the compass does not show the first 60° of a turn."""
    leeway: float = 1.5  # limit of time and angle in multiples of the plan, because wheels slip
    farthest_beyond: float = math.radians(45.0)  # limit beyond either end, because a robot coasts
    smoothed: float = 0.2  # time constant of the gyro's rate, seconds
    spacing: float = math.radians(2.0)
    """Angle between the samples that are kept to compare gyro, commands and field, radians."""
    spans: tuple[float, ...] = tuple(map(math.radians, (75.0, 150.0, 300.0)))
    """Spans of either angle that are tested, radians; a larger span is more conclusive."""
    disagree: float = 0.38  # relative difference of gyro and commands from which the field decides
    factors: tuple[float, float, float] = (0.85, 1.0, 1.2)  # scales of an angle that are tried
    clearly_worse: float = 1.4  # ratio of squared misfits from which an angle is rejected
    smallest_radius: float = 1.5e-6  # tesla; a field on a smaller circle has not turned


@dataclass(frozen=True)
class SelfTurnTuning:
    """Time limits of a robot that turns itself, and the end of its commands."""

    zeros: int = 10  # zeros that are sent at the end, because a single message may be lost
    silence: float = 1.0  # seconds without messages of a sensor after which the robot is stopped
    gyro_silence: float = 0.5
    """Seconds without an angular velocity, or between two calls of `SelfTurn.look`, after which the
    moving robot is stopped."""
    listeners_within: float = 3.0  # seconds within which the commands must have a subscription
    guarded_within: float = 10.0  # longest wait for the guard, s; a small computer needs three


@dataclass(frozen=True)
class KnownHeadingTuning:
    """Rests at a known heading, and the comparison of a device's headings with the gyro."""

    fewest: int = 10  # field samples that a mean needs
    patience: float = 15.0  # steady-clock seconds after which the samples are taken as too few
    rate: float = math.radians(1.5)  # rad/s without the bias from which the robot turns
    creep: float = 0.7e-6  # largest change of the field in a rest, without noise, tesla
    same: float = math.radians(5.0)  # radians within which a new heading replaces another
    most: int = 24  # measurements that are kept
    turn: float = math.radians(40.0)  # smallest turn by the gyro for a comparison, radians
    apart: float = math.radians(12.0)  # largest difference in a comparison, radians
    times: int = 3  # successive failed comparisons from which the headings are refused
    longest: float = 60.0  # seconds over which the gyro is integrated for a comparison


@dataclass(frozen=True)
class HeadingLogTuning:
    """The means that are kept of a drive with external headings."""

    each: int = 8  # means that are kept in each sector, and new means needed for a fit
    block: float = 0.5  # seconds of a mean
    rate: float = 0.1  # rad/s from which a delay between heading and field matters
    common: float = math.radians(0.5)
    """Sigma of the device's mounting yaw, radians: a centimetre for antennas a metre apart."""
    force: float = 0.15  # sigma of the up vector in a drive, m/s² per axis


SESSION = SessionTuning()
ROTATION = RotationTuning()
SELF_TURN = SelfTurnTuning()
KNOWN = KnownHeadingTuning()
LOG = HeadingLogTuning()
