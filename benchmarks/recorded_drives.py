"""Decisions of self-calibration on recordings: `python benchmarks/recorded_drives.py [FOLDER...]`.

Each recording is repeated as `magcal drive` does, all of it and its halves: from nothing, and
with the calibration in force that the smoother finds on all of it, which nothing should replace.
Where more than six minutes were driven, 10 µT are added after two of them, in eight directions; and
a rough calibration is in force, off by draws of its own uncertainty, which a better one should
replace.
Degrees of heading, RMS against the truth on the whole recording, a constant taken off. With
`--changed` other sensors have recorded the same drives (`changed_recordings.py`).
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import shared_cases  # noqa: F401
from changed_recordings import CHANGES, changed
from recorded_truth import Drive, in_force, read_drive
from recordings import DEFAULT, recordings_in

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.calibration.heading_sigma import predicted_heading_sigma
from magcal_ros.core.geometry.attitude import yaw_from_up_and_field
from magcal_ros.core.samples.streams import FieldSample
from magcal_ros.core.self_calibration.drive_replay import DriveReplay, replay_drive
from magcal_ros.core.self_calibration.jobs import difference

WORSE = 0.3
LONG, CHANGE_AT, ADDED = 360.0, 120.0, 10e-6
ROUGH = math.radians(10.7)
"""Standard deviation of the level hard iron of a rough calibration, over the level field."""
DRAWS = (1, 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="*", default=[DEFAULT])
    parser.add_argument("--only", default="", help="recordings whose name holds this")
    parser.add_argument("--changed", choices=[*CHANGES], help="by other sensors")
    arguments = parser.parse_args()
    worse = windows = 0
    for folder in recordings_in(arguments.folders):
        drive = changed(read_drive(folder, None), arguments.changed)
        if arguments.only not in folder.name or drive.everything.angular_rate is None:
            continue
        print_result("from nothing", drive, None, replayed(drive, None, 0.0, 1.0))
        for initial, name in in_force(drive):
            for first, last in ((0.0, 1.0), (0.0, 0.6), (0.4, 1.0)):
                replay = replayed(drive, initial, first, last)
                windows += 1
                worse += print_result(f"{name}, {first:.0%} to {last:.0%}", drive, initial, replay)
            if drive.everything.time[-1] - drive.everything.time[0] > LONG:
                for seed in DRAWS:
                    rough = roughly(initial, seed)
                    print_result(
                        f"a rough one in force, draw {seed}", drive, rough, replayed(drive, rough)
                    )
                for eighth in range(8):
                    print_change(drive, initial, eighth * 0.25 * math.pi)
    print(f"with a calibration in force: {windows} windows, {worse} made worse by > {WORSE}°")


def roughly(known: Calibration, seed: int) -> Calibration:
    """Return a calibration with a roughly known level hard iron."""
    sigma = ROUGH * known.strength * math.cos(known.inclination) * np.array([1.0, 1.0, 0.0])
    off = np.random.default_rng([34, seed]).normal(0.0, 1.0, 3) * sigma
    covariance = known.covariance.copy()
    covariance[9:, 9:] += np.diag(sigma**2)
    correction = replace(known.correction, hard_iron=known.correction.hard_iron + off)
    return replace(known, correction=correction, covariance=covariance)


def replayed(
    drive: Drive, initial: Calibration | None, first: float = 0.0, last: float = 1.0
) -> DriveReplay:
    time = drive.everything.time
    start, stop = (time[0] + share * (time[-1] - time[0]) for share in (first, last))
    samples = (each for each in drive.recording.samples() if start <= each.stamp <= stop)
    return replay_drive(drive.knowledge, initial, samples, ())


def print_change(drive: Drive, initial: Calibration, way: float) -> None:
    """Add iron on the way, and say what comes of it: degrees from what is then right."""
    iron = ADDED * np.array([math.cos(way), math.sin(way), 0.0])
    start = drive.everything.time[0] + CHANGE_AT
    replay = replay_drive(
        drive.knowledge,
        initial,
        (
            each._replace(field=tuple(np.add(each.field, iron).tolist()))
            if isinstance(each, FieldSample) and each.stamp > start
            else each
            for each in drive.recording.samples()
        ),
        (),
    )
    old = initial.correction
    right = replace(initial, correction=Correction(old.matrix, old.hard_iron + iron))
    print(f"{drive.name:28s}10 µT added at {CHANGE_AT:.0f} s, off by", end=" ")
    print(f"{math.degrees(difference(initial, right)):.0f}°:", end=" ")
    for at, made in replay.decisions:
        left = ""
        if made.calibration is not None:
            left = f" ({math.degrees(difference(made.calibration, right)):.1f}°)"
        print(f"{made.kind.value} after {at - CHANGE_AT:.0f} s{left}", end=" ")
    print(flush=True)


def score(drive: Drive, calibration: Calibration | None) -> float:
    if calibration is None:
        return math.nan
    apply = calibration.correction.apply
    found = drive.score(lambda up, raw: yaw_from_up_and_field(up, apply(raw)))
    return found.rms if found else math.nan


def print_result(name: str, drive: Drive, initial: Calibration | None, replay: DriveReplay) -> bool:
    before, after = score(drive, initial), score(drive, replay.last_calibration)
    stated = (
        math.degrees(predicted_heading_sigma(replay.last_calibration))
        if replay.last_calibration
        else math.nan
    )
    first = next((at for at, made in replay.decisions if made.calibration is not None), math.nan)
    made = " ".join(each.kind.value for _, each in replay.decisions)
    is_worse = after > before + WORSE
    print(
        f"{drive.name:28s}{name:32s}{replay.moved:5.0f} s moved, changed after {first:4.0f} s, said"
        f" {stated:4.1f}, rms {before:5.2f} -> {after:5.2f}{' WORSE' if is_worse else ''} {made}",
        flush=True,
    )
    return is_worse


if __name__ == "__main__":
    main()
