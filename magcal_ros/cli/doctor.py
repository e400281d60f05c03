"""`magcal doctor`: what is wrong with the sensors, from a recording, and the line that mends it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from magcal_ros.cli.common import Exit, bullets, document
from magcal_ros.cli.recorded import (
    add_knowledge_options,
    add_recording_options,
    mounting_from,
    watched,
)
from magcal_ros.cli.reference import reference_in_use
from magcal_ros.core.assessment.axes import AxesFound, find_axes, parameter_line
from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.assessment.health import (
    TUNING,
    Finding,
    field_findings,
    imu_findings,
    stamps_finding,
)
from magcal_ros.core.errors import Refusal
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.session.recorded import Gathering, Reading
from magcal_ros.files.atomic import FileTrouble
from magcal_ros.files.sources import open_recording

MOST = 500_000
"""Samples kept of each stream: more than an hour at 100 Hz."""

NO_TURN = "turn once, and lift the nose by 20° while it turns"


def add_to(commands: Any) -> None:
    """Add the command's arguments."""
    parser = commands.add_parser(
        "doctor",
        help="say what is wrong with the sensors of a recording",
        description="Look at stamps, units, gravity, repeats, resolution, range and axes of the "
        "sensors in a recording, at best of a turn during which the nose is lifted. Exit status: "
        "0 nothing is wrong, 2 usage, 3 too little data, 4 something is, 5 file trouble.",
    )
    add_recording_options(parser)
    parser.add_argument(
        "--write", type=Path, metavar="FILE", help="write the mounting found as a parameter file"
    )
    add_knowledge_options(parser)
    parser.set_defaults(run=run)


class _Kept:
    """Keeps the readings that pass by."""

    def __init__(self) -> None:
        self.imu: list[ImuSample] = []
        self.field: list[FieldSample] = []

    def passing(self, readings: Iterator[Reading]) -> Iterator[Reading]:
        for reading in readings:
            if isinstance(reading, ImuSample) and len(self.imu) < MOST:
                self.imu.append(reading)
            elif isinstance(reading, FieldSample) and len(self.field) < MOST:
                self.field.append(reading)
            yield reading


def run(options: argparse.Namespace) -> int:
    """Read, look, and say what was found."""
    if options.write is not None and options.write.exists():
        raise FileTrouble(f"{options.write} exists already: name another --write")
    kept, mounting = _Kept(), mounting_from(options)
    with open_recording(
        options.recording,
        imu=options.imu,
        field=options.mag,
        start=options.start,
        stop=options.stop,
    ) as source:
        gathering = Gathering(mounting, source.imu_topic, source.field_topic)
        gathering.take(kept.passing(watched(source, sys.stderr)))
        newest = gathering.streams.field_stamps.newest
        reference = reference_in_use(options, source.place(), newest)
    if min(len(kept.imu), len(kept.field)) < TUNING.fewest:
        counts = f"{len(kept.imu)} IMU and {len(kept.field)} field samples"
        print(document({"findings": []}) if options.json else f"Too little data: {counts}.")
        return Exit.TOO_LITTLE_DATA
    axes, axes_finding = _axes(gathering, Knowledge(reference.field, mounting))
    findings = [*_of_streams(kept), axes_finding]
    complaints = gathering.complaints()
    findings += [Finding("recording", Grade.WARN, words) for words in complaints]
    mount = None if axes is None or axes.right else axes.mount_rpy_deg
    wrong = any(finding.grade is not Grade.EXCELLENT for finding in findings)
    status = Exit.REFUSED if wrong else Exit.GOOD
    written = _write(options.write, axes)
    print(document(_facts(findings, mount, written, status)) if options.json else _words(findings))
    if written and not options.json:
        print(f"\nWritten: {written}")
    return status


def _of_streams(kept: _Kept) -> list[Finding]:
    field = np.array([sample.field for sample in kept.field])
    force = np.array([sample.force for sample in kept.imu])
    rate = np.array([sample.rate for sample in kept.imu])
    found = []
    for name, samples in (("IMU", kept.imu), ("field", kept.field)):
        time = np.unique([sample.stamp for sample in samples])
        if len(time) > TUNING.fewest:
            found.append(stamps_finding(name, time))
    finite = np.isfinite(field).all(axis=1)
    if finite.sum() > TUNING.fewest:
        found += field_findings(field[finite])
    known = np.isfinite(rate).all(axis=1)
    force = force[np.isfinite(force).all(axis=1)]
    if len(force) > TUNING.fewest:
        found += imu_findings(force, rate[known] if known.sum() > TUNING.fewest else None)
    return found


def _axes(gathering: Gathering, knowledge: Knowledge) -> tuple[AxesFound | None, Finding]:
    name = "magnetometer: axes"
    try:
        found = find_axes(gathering.window(), knowledge)
    except Refusal:
        found = None
    if found is None:
        return None, Finding(name, Grade.EXCELLENT, f"not shown: {NO_TURN}, with a gyro")
    if not found.right:
        return found, Finding(name, Grade.REFUSED, "gyro and field disagree", found.words)
    more = len(found.candidates) - 1
    evidence = (
        "x forward, y left, z up"
        if np.array_equal(knowledge.mounting.pose, np.eye(3))
        else "as mount_rpy_deg says"
    )
    if more > 0:
        evidence += f" fit, and {more} more. To tell which, {found.movement}"
    return found, Finding(name, Grade.EXCELLENT, evidence)


def _write(path: Path | None, axes: AxesFound | None) -> str | None:
    """Leave a parameter file where one mounting alone explains the axes; returns its path."""
    if path is None:
        return None
    if axes is None or axes.right or len(axes.candidates) != 1 or axes.mount_rpy_deg is None:
        return None
    line = parameter_line(axes.mount_rpy_deg)
    path.write_text(f"/**:\n  ros__parameters:\n    {line}\n", encoding="utf-8")
    return str(path)


def _words(findings: list[Finding]) -> str:
    marks = {Grade.EXCELLENT: "ok", Grade.WARN: "look", Grade.REFUSED: "wrong"}
    lines = [f"  {marks[f.grade]:<6}{f.name:<20}{f.evidence}" for f in findings]
    remedies = [f"{f.name}: {f.remedy}" for f in findings if f.remedy]
    return "\n".join(lines) + bullets("\nWhat to do:", remedies).rstrip("\n")


def _facts(
    findings: list[Finding], mount: tuple[int, int, int] | None, written: str | None, status: Exit
) -> dict[str, Any]:
    return {
        "findings": [
            {"name": f.name, "grade": f.grade.value, "evidence": f.evidence, "remedy": f.remedy}
            for f in findings
        ],
        "mount_rpy_deg": mount,
        "written": written,
        "exit": int(status),
    }
