"""`magcal doctor`: faults of the sensors, live or recorded, and the remedy of each."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magcal_ros.cli.common import Exit, bullets, document, reference_in_use
from magcal_ros.cli.recorded import (
    add_knowledge_options,
    add_recording_options,
    mounting_from,
    opened,
    watched,
)
from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.doctor.blame import UserAnswers
from magcal_ros.core.doctor.course import CourseSeen
from magcal_ros.core.doctor.health import TUNING, Finding, looked_at
from magcal_ros.core.doctor.page import Page, examine
from magcal_ros.core.errors import Misuse
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Knowledge, ReferenceField
from magcal_ros.core.monitoring.recorded_course import RecordedCourse, recorded_course
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.samples.window import SensorLog
from magcal_ros.core.session.recorded import Gathering, Reading
from magcal_ros.files.atomic import FileTrouble, write_atomically
from magcal_ros.files.reading import plain, plain_lines

MOST = 500_000
"""Samples kept of each stream: more than an hour at 100 Hz."""


def add_to(commands: Any) -> None:
    """Add the command's arguments."""
    parser = commands.add_parser(
        "doctor",
        help="say what is wrong with the sensors, live or of a recording",
        description="Look at stamps, latency, units, gravity, repeats, resolution, range, noise "
        "and axes of the sensors, and say what to change. Without a recording it listens to the "
        "running sensors for a guided half minute: stand still, turn left, lift the nose. Exit "
        "status: 0 nothing is wrong (but lines may be worth a look), 2 usage, 3 too little data, "
        "4 something is wrong, 5 file trouble.",
    )
    add_recording_options(parser, optional=True)
    parser.add_argument(
        "--live", action="store_true", help="listen to the running sensors (without a recording)"
    )
    parser.add_argument(
        "--turned",
        choices=("left", "right"),
        help="to which side the robot of a recording turned; tells what turns alike",
    )
    parser.add_argument(
        "--write", type=Path, metavar="FILE", help="write what was found as a parameter file"
    )
    add_knowledge_options(parser)
    parser.set_defaults(run=run)


class _Kept:
    """Keeps the readings that pass by."""

    def __init__(self) -> None:
        self.samples: list[ImuSample | FieldSample] = []
        self._left = {ImuSample: MOST, FieldSample: MOST}

    def passing(self, readings: Iterator[Reading]) -> Iterator[Reading]:
        for reading in readings:
            if reading is not None and self._left[type(reading)] > 0:
                self._left[type(reading)] -= 1
                self.samples.append(reading)
            yield reading


def run(options: argparse.Namespace) -> int:
    """Look, and say what was found."""
    if options.write is not None and options.write.exists():
        raise FileTrouble(f"{options.write} exists already: name another --write")
    if options.recording is not None and options.live:
        raise Misuse("a recording is not live: leave out --live, or the recording")
    if options.recording is None:
        from magcal_ros.cli.doctor_live import listen

        heard = listen(options)
        if _too_little(heard.log):
            return _nothing(options, heard.log, heard.more)
        page = heard.page_with(examine(heard.log, heard.knowledge, heard.answers))
        return _tell(options, page, heard.knowledge.mounting.gains)
    return _recorded(options)


def _recorded(options: argparse.Namespace) -> int:
    kept, mounting = _Kept(), mounting_from(options)
    with opened(options, options.recording) as source:
        gathering = Gathering(mounting, source.imu_topic, source.field_topic)
        gathering.take(kept.passing(watched(source, source.readings(), sys.stderr)))
        newest = gathering.streams.field_stamps.newest
        reference = reference_in_use(options, source.place(), newest)
        travel = source.travel()
    answers = UserAnswers(None if options.turned is None else options.turned == "left")
    complaints = [*source.notes, *gathering.complaints(), *reference.complaints]
    more = [looked_at("recording", "recording", words, words) for words in complaints]
    log = SensorLog.of(kept.samples)
    if _too_little(log):
        return _nothing(options, log, more)
    page = examine(log, Knowledge(reference.field, mounting), answers).with_more(more)
    if travel and page.used is not None:
        course = recorded_course(page.used.compass, kept.samples, travel)
        page = page.with_course(_course_seen(course, reference.field))
    return _tell(options, page, mounting.gains)


def _course_seen(course: RecordedCourse | None, field: ReferenceField) -> CourseSeen:
    if course is None:
        return CourseSeen()
    north, offset, mounting = field.declination or 0.0, course.offset, course.mounting
    yaw = 0.0 if mounting is None else mounting.yaw
    gap = math.remainder(offset.offset - north - yaw, math.tau)
    if mounting is None:
        return CourseSeen(gap, offset.sigma)
    return CourseSeen(gap, math.hypot(offset.sigma, mounting.sigma), yaw, mounting.sigma)


def _too_little(log: SensorLog) -> bool:
    return min(len(log.imu_time), len(log.field_time)) < TUNING.fewest


def _nothing(options: argparse.Namespace, log: SensorLog, more: Sequence[Finding]) -> int:
    facts = page_as_facts(Page(tuple(more)), None, Exit.TOO_LITTLE_DATA)
    counts = f"{len(log.imu_time)} IMU and {len(log.field_time)} field samples"
    print(document(facts) if options.json else f"Too little data: {counts}.")
    return Exit.TOO_LITTLE_DATA


def _tell(options: argparse.Namespace, page: Page, gains: FloatArray) -> int:
    """Print the page and write what parameters can correct."""
    status = Exit.REFUSED if page.misleads else Exit.GOOD
    written = write_parameters(options.write, page, None if np.allclose(gains, 1.0) else gains)
    if options.json:
        print(document(page_as_facts(page, written, status)))
        return status
    words = page_in_words(page)
    if options.write is not None:
        nothing = "Nothing is written: no parameter alone corrects what was found."
        words = f"{words}\n\n{f'Written: {written}' if written else nothing}"
    print(plain_lines(words))
    return status


MARKS = {Grade.EXCELLENT: "ok", Grade.GOOD: "-", Grade.WARN: "look", Grade.REFUSED: "wrong"}


def page_in_words(page: Page) -> str:
    """Return the page for a terminal: a line for each finding, then what to do."""
    lines = [f"  {MARKS[f.grade]:<6}{f.name:<27}{plain(f.evidence, 300)}" for f in page.findings]
    worst_first = sorted(page.findings, key=lambda finding: -finding.grade.rank)
    # One cause may show in several lines.
    remedies = {f.remedy: f.name for f in reversed(worst_first) if f.remedy}
    todo = [f"{name}: {plain(words, 1000)}" for words, name in reversed(remedies.items())]
    return "\n".join(lines) + bullets("\nWhat to do:", todo).rstrip("\n")


def page_as_facts(page: Page, written: str | None, status: Exit) -> dict[str, Any]:
    """Return the page for programs."""
    return {
        "findings": [
            {
                "key": f.key,
                "name": f.name,
                "grade": f.grade.value,
                "evidence": f.evidence,
                "remedy": f.remedy,
            }
            for f in page.findings
        ],
        "mount_rpy_deg": page.mount_rpy_deg,
        "written": written,
        "exit": int(status),
    }


def write_parameters(path: Path | None, page: Page, gains: FloatArray | None) -> str | None:
    """Leave what parameters can correct, and the gains that were given; returns the path.

    Nothing is written where no mounting alone corrects the axes: what a driver does wrong is
    corrected there, and never here.
    """
    if path is None or not page.parameters:
        return None
    lines = [page.parameters]
    if gains is not None:
        lines.append(f"soft_iron_gains: [{', '.join(f'{float(gain)!r}' for gain in gains)}]")
    text = "\n".join(["/**:", "  ros__parameters:", *(f"    {line}" for line in lines)])
    write_atomically(path, text + "\n", "Choose a writable folder, or correct its permissions.")
    return str(path)
