"""The assumptions about incoming samples: each number with its unit and its reason."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class StreamTuning:
    """Limits of valid samples, and of the gaps between samples."""

    restart_after: int = 10
    """Consecutive stamps before the newest after which time was set back (a looped bag)."""
    max_gap: float = 0.2  # seconds; IMU samples further apart are usually not interpolated between
    longest_gyro_step: float = 0.5
    """Longest gap between two samples over which the gyro is integrated, seconds."""
    longest_field_gap: float = 0.6
    """The same for the field of a drive, seconds; gaps at 2 Hz are often longer than 0.5 s."""
    longest_pause: float = 3600.0
    """Seconds, the longest turn (`window.timeout_s`). A longer gap between two stamps is no pause
    of the robot: a clock was set."""
    remembered: int = 4096  # samples kept of each stream: four seconds of the fastest sensors
    smallest: float = 1e-9  # tesla and m/s²; less is a sensor that reads nothing
    largest_field: float = 1e-3
    """Tesla, twenty times the Earth's field. More is a unit error or a magnet on the sensor."""
    largest_force: float = 1e5
    """m/s². No accelerometer reads more, milli-g published as m/s² included."""
    largest_rate: float = 1e4  # rad/s, no gyro reads more, degrees published as radians included
    largest_current: float = 1e6
    """A. No robot draws more, milliamperes published as amperes included."""


@dataclass(frozen=True)
class BurstTuning:
    """When stamps come in bursts."""

    share: float = 0.5  # least fraction of the time in gaps between bursts
    longer: float = 5.0  # least length of such a gap, in median gaps
    fewest: int = 10  # least number of such gaps; fewer are pauses
    apart: float = 0.25
    """Largest median distance of the gaps from their median, relative to it: buffers are read at
    regular intervals."""
    each: float = 3.0  # least samples in a burst; pairs are more likely repeated messages
    straight: float = 1.5
    """Largest range of the stamps about a constant rate, in gaps between bursts; beyond, whole
    bursts are missing."""
    harmful: float = 0.1  # seconds between bursts from which a running node warns
    watched: int = 3000  # newest gaps that are examined while samples come


@dataclass(frozen=True)
class DiagnosisTuning:
    """When a stream causes a complaint."""

    worth_a_word: float = 0.02  # fraction of dropped samples from which they are reported
    most_repeats: float = 0.9
    """Fraction of repeated field values from which the sensor is frozen or the robot at rest."""
    frozen_turn: float = math.radians(20.0)
    """Radians. Turn of the robot during which no working magnetometer repeats one value."""
    largest_offset: float = 1.0  # seconds between the two sensors' newest stamps
    ahead_in_gaps: float = 1.5
    """Largest lead of the field over the IMU by jitter, in `max_gap`."""


@dataclass(frozen=True)
class CoverageTuning:
    """When a turn is detected, and when it is complete."""

    largest_gap: float = math.radians(20.0)  # radians, of a complete turn
    spacings: float = 4.0  # mean distances between samples that do not count as a gap
    spread_over_noise: float = 6.0
    """Least ratio of the field's spread to its noise before the phase is used."""
    smallest_radius: float = 4e-6  # tesla, a smaller circle is noise, or a robot at rest
    gyro_leads_until: float = math.radians(60.0)
    """Radians. A shorter arc does not determine the field's circle; the gyro is used instead."""
    smallest_turn: float = math.radians(10.0)
    """Radians. Least turn by the gyro, in addition to the drift by its largest bias."""
    largest_gyro_bias: float = math.radians(1.0)  # rad/s, of a gyro at rest


@dataclass(frozen=True)
class BiasAtRestTuning:
    """When a robot counts as resting, and which part of a rest is used."""

    block: float = 0.5  # seconds of samples that are averaged before they are compared
    at_least: int = 4  # consecutive blocks in a rest
    clear: float = 4.0  # sigmas of a block's mean by which two blocks at rest may differ
    smallest_turn: float = 0.004
    """Change of the field during a rest beyond white noise, over the field's range."""
    shown: float = 3.0
    """Least ratio of two changes of the field: by a turn at the gyro's rate (without a gyro, in the
    whole window), and the limit of a rest."""
    most_moved: float = 0.4
    """Largest change of the field during a rest, over that by a turn at the gyro's rate."""
    loose_rate: float = 0.01  # rad/s by which an engine or a person may rock a robot at rest
    slow_share: float = 0.05
    """Fraction of the turn's rate below which a constant rate counts as a rest."""
    longest: float = 10.0
    """Seconds of a rest next to the turn that are used; earlier, things may have been moved."""
    fewest: int = 20  # rows of a turn; with fewer, the robot hardly moved


@dataclass(frozen=True)
class RecorderTuning:
    """How a drive is averaged, and when the robot rests during it."""

    row: float = 0.1  # seconds of samples in one row
    chunk: int = 10  # rows between tests for a rest
    rests: int = 60  # newest rests whose gyro bias is stored
    rest_chunks: int = 60  # memory of the mean rate during a rest, in chunks
    rest_field: float = 0.6e-6
    rest_rate: float = math.radians(0.5)
    rest_force: float = 0.15
    rest_noise: float = 0.5
    rest_speed: float = 0.1
    """Limits of a rest over five seconds. For field (tesla) and rate (rad/s): the difference of
    both halves, plus `rest_noise` standard deviations. For force: its standard deviation, m/s². For
    a known speed: its size, m/s."""


STREAMS = StreamTuning()
BURSTS = BurstTuning()
COMPLAINTS = DiagnosisTuning()
COVERAGE = CoverageTuning()
BIAS_AT_REST = BiasAtRestTuning()
RECORDER = RecorderTuning()
