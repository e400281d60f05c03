"""Replay of self-calibration on a recorded drive, and a map of the disturbed field.

Streams, up, speed and state machine are those of the node; jobs are done at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.driving.travel_estimator import TravelReplay
from magcal_ros.core.geometry.arrays import FloatArray, interpolated
from magcal_ros.core.geometry.attitude import level_part, yaw_from_up_and_field
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import (
    FieldSample,
    ImuSample,
    Pairer,
    PositionSample,
    Streams,
    TravelSample,
)
from magcal_ros.core.samples.window import Window
from magcal_ros.core.self_calibration.jobs import SELF_CALIBRATION, Decision, Mode
from magcal_ros.core.self_calibration.self_calibration import SelfCalibration
from magcal_ros.core.self_calibration.worker import examine_drive
from magcal_ros.core.up.follower import propagated_up


@dataclass(frozen=True, eq=False)
class DrivePath:
    """The path of a drive, with the disturbance of the field under the last calibration."""

    place: FloatArray  # metres east and north of the beginning. Shape (n, 2).
    error: FloatArray
    """Possible error of the heading by the disturbance, radians: its component across north is
    assumed to be as large as the deviation of level and vertical field. Shape (n,)."""
    is_measured: bool  # whether places are from a receiver; else dead reckoning
    has_speed: bool  # whether a speed was measured; else it is assumed


@dataclass(frozen=True, eq=False)
class DriveReplay:
    """The result of a replay."""

    decisions: tuple[tuple[float, Decision], ...]  # seconds from the beginning, and the decision
    first_calibration: Calibration | None  # in force at the beginning
    last_calibration: Calibration | None  # in force at the end
    seconds: float  # duration of the recording
    moved: float  # seconds of movement
    state: str  # the state at the end, in words
    path: DrivePath | None  # None without a calibration
    course: str = ""  # comparison of compass and course at the end, in words; or empty
    fault: str = ""  # possible fault of the sensors, if no calibration was found


def replay_drive(
    knowledge: Knowledge,
    calibration: Calibration | None,
    readings: Iterable[ImuSample | FieldSample | None],
    travel: Iterable[TravelSample],
    machine: SelfCalibration | None = None,
) -> DriveReplay:
    """Run self-calibration on a recording.

    Readings are in order of arrival, travel in order of stamps; `calibration` is in force at the
    beginning.
    """
    streams, ways = Streams(STREAMS.max_gap), list(travel)
    replay, now, pairer = TravelReplay(ways, streams), calibration, Pairer(streams)
    machine = SelfCalibration(Mode.APPLY) if machine is None else machine
    machine.put_in_force(calibration)
    decisions: list[tuple[float, Decision]] = []
    points: list[tuple[float, ...]] = []  # stamp, speed, raw field and up
    first, last, due = math.nan, math.nan, -math.inf
    for sample in replay.readings(readings):
        imu = streams.newest_imu
        if not isinstance(sample, FieldSample) or imu is None or not math.isfinite(imu.rate[0]):
            continue
        last = sample.stamp
        first = last if math.isnan(first) else first
        speed, up = replay.estimator.speed, replay.up.newest
        if up is not None and not last < due:
            points.append((last, speed, *sample.field, *up))
            due = last + SELF_CALIBRATION.map_every
        pairer.offer(sample)
        for pair in pairer.take():
            if not machine.add(pair, speed):
                continue
            for decision in machine.note(examine_drive(machine.job(knowledge))):
                decisions.append((last - first, decision))
                if decision.is_change:
                    now = decision.calibration
                    machine.put_in_force(now)
    path = None
    if now is not None and len(points) > 1:
        rows = np.array(points)
        fixes = np.array([each[:3] for each in ways if isinstance(each, PositionSample)])
        measured = fixes if len(fixes) > 2 else None
        path = path_along(now, rows[:, 0], rows[:, 2:5], rows[:, 5:], rows[:, 1], measured)
    seconds = 0.0 if math.isnan(first) else last - first
    moved = machine.recorder.moved
    return DriveReplay(tuple(decisions), calibration, now, seconds, moved, machine.in_words, path)


def path_along(
    calibration: Calibration,
    time: FloatArray,
    raw: FloatArray,
    up: FloatArray,
    speed: FloatArray,
    fixes: FloatArray | None = None,
) -> DrivePath:
    """Return the path of a drive with the disturbance of the field.

    Raw field (tesla) and up are (n, 3) in body axes, `time` (n,) in seconds, `speed` (n,) in m/s,
    NaN if unknown. `fixes` (k, 3) are stamps, metres east and north; without them places are
    dead-reckoned.
    """
    field = calibration.correction.apply(raw)
    rise = np.sum(field * up, axis=1)
    level = np.linalg.norm(level_part(field, up), axis=1)
    dip = calibration.inclination
    disturbance = np.hypot(
        level - calibration.strength * math.cos(dip), rise + calibration.strength * math.sin(dip)
    )
    error = np.arctan2(disturbance, calibration.strength * math.cos(dip))
    known = np.isfinite(speed)
    if fixes is not None:
        place = interpolated(time, fixes[:, 0], fixes[:, 1:])
    else:
        yaw = yaw_from_up_and_field(up, field)
        steps = np.diff(time, prepend=time[0]).clip(0.0, 2.0 * SELF_CALIBRATION.map_every)
        steps *= np.where(known, speed, SELF_CALIBRATION.usual_speed)
        place = np.cumsum(steps[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)]), axis=0)
    is_measured = fixes is not None
    return DrivePath(place - place[0], error, is_measured, bool(known.any()))


def path_of_log(log: Window, calibration: Calibration) -> DrivePath | None:
    """Return the path of the record of a drive; None if it is too short."""
    if len(log) < 10:
        return None
    every = max(1, round(SELF_CALIBRATION.map_every / float(np.median(np.diff(log.time)))))
    up, speed = propagated_up(log), np.full(len(log), math.nan) if log.speed is None else log.speed
    rows = (values[::every] for values in (log.time, log.field, up, speed))
    return path_along(calibration, *rows)
