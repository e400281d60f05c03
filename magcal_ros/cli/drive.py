"""`magcal drive`: what self-calibration would have decided on a recorded drive."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from magcal_ros.cli.common import (
    Exit,
    add_output_option,
    bullets,
    document,
    new_or_named,
    reference_in_use,
)
from magcal_ros.cli.recorded import (
    add_knowledge_options,
    add_recording_options,
    at_work,
    mounting_from,
    opened,
)
from magcal_ros.core.keeping.story import DriveReplay, DriveStory
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.monitoring.recorded_course import recorded_course
from magcal_ros.files.calibration_file import Origin, read_calibration, write_calibration
from magcal_ros.files.reading import plain, plain_lines
from magcal_ros.files.repaired_readings import RepairedReadings
from magcal_ros.report.drive_page import VERBS, summary_of, write_drive_page

CALIBRATION = "calibration.yaml"


def add_to(commands: Any) -> None:
    """Add the command's arguments."""
    parser = commands.add_parser(
        "drive",
        help="say what a recorded drive tells of the compass",
        description="Tell a recorded drive again: what self-calibration would have decided and "
        "why, and a map of where the field is bent. Exit status: 0 a calibration is in force at "
        "the end, 2 usage, 3 none is, 5 file trouble.",
    )
    add_recording_options(parser)
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE", help="in force at the beginning (default: none)"
    )
    add_output_option(parser, "the report", "magcal_drive")
    add_knowledge_options(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Read, decide again, write the page."""
    begun = None if options.calibration is None else read_calibration(options.calibration)[0]
    folder = new_or_named(options.output, "magcal_drive")
    with opened(options, options.recording) as source:
        reference = reference_in_use(options, source.place(), source.begun())
        replay = DriveReplay(Knowledge(reference.field, mounting_from(options)), begun)
        repaired = RepairedReadings(source, for_drive=True, known=begun)
        travel = source.travel()
        with at_work(
            lambda: f"fitting the drive, {100.0 * repaired.share:.0f} % of it", sys.stderr
        ):
            replay.take(repaired, travel)
        frames = source.field_frame, source.imu_frame
        story = replay.story()
        if story.ended is not None and travel:
            north = reference.field.declination
            course = recorded_course(story.ended, repaired, travel, north)
            story = replace(story, course="" if course is None else course.words)
    page = write_drive_page(folder, story, plain(str(options.recording)))
    files = [page]
    if story.ended is not None and story.ended is not begun:
        files.append(folder / CALIBRATION)
        write_calibration(files[-1], story.ended, Origin.now(*frames))
    notes = list(dict.fromkeys([*source.notes, *repaired.notes]))
    content = story, notes, files
    print(document(_facts(*content)) if options.json else plain_lines(_words(*content)))
    return Exit.TOO_LITTLE_DATA if story.ended is None else Exit.GOOD


def _words(story: DriveStory, notes: list[str], files: list[Path]) -> str:
    lines = [summary_of(story)]
    lines += [f"At the end: {story.course}."] if story.course else []
    lines += [f"{at:6.0f} s  {VERBS[made.verb]}: {made.words}" for at, made in story.decisions]
    lines += bullets("About the recording:", notes).strip("\n").splitlines()
    return "\n".join([*lines, *(f"Written: {file}" for file in files)])


def _facts(story: DriveStory, notes: list[str], files: list[Path]) -> dict[str, Any]:
    return {
        "summary": summary_of(story),
        "course": story.course or None,
        "decisions": [
            {"at_s": round(at, 1), "decision": made.verb.value, "why": made.words}
            for at, made in story.decisions
        ],
        "about": notes,
        "files": [str(file) for file in files],
    }
