"""`magcal check`: whether a calibration still holds on a fresh recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from magcal_ros.cli.common import (
    Exit,
    add_output_option,
    add_reference_options,
    bullets,
    document,
    new_or_named,
    table,
)
from magcal_ros.cli.recorded import Gathered, add_recording_options, gather, opened
from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.earth_field.reference import made_elsewhere
from magcal_ros.core.errors import Refusal
from magcal_ros.core.knowledge import Knowledge, Mounting
from magcal_ros.core.monitoring.recheck import STATES, Recheck, check
from magcal_ros.core.monitoring.recorded_course import against_own_yaw, recorded_course
from magcal_ros.core.samples.window import Window
from magcal_ros.files.calibration_file import Origin, read_calibration
from magcal_ros.files.reading import plain, plain_lines
from magcal_ros.files.repaired_readings import RepairedReadings
from magcal_ros.report import Subject, write_report


def add_to(commands: Any) -> None:
    """Add the command's arguments."""
    parser = commands.add_parser(
        "check",
        help="say whether a calibration still holds on a fresh recording",
        description="Say whether a calibration still holds on a fresh recording in which the "
        "robot turns. Exit status: 0 it holds or is doubtful (the words tell), 2 usage, 3 too "
        "little data, 4 stale, 5 file trouble.",
    )
    add_recording_options(parser)
    parser.add_argument(
        "--calibration", type=Path, required=True, metavar="FILE", help="the calibration"
    )
    add_output_option(parser, "the report", "magcal_check")
    add_reference_options(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Read both, compare, and say what came of it."""
    calibration, origin = read_calibration(options.calibration)
    with opened(options, options.recording) as source:
        gathered = gather(options, Mounting(), source, calibration)
        north = gathered.reference.field.declination
        travel, readings = source.travel(), RepairedReadings(source, known=calibration)
        course = recorded_course(calibration, readings, travel, north) if travel else None
        own = against_own_yaw(calibration, readings, source.yaw(), north)
    folder = new_or_named(options.output, "magcal_check")
    elsewhere = made_elsewhere(calibration, gathered.reference.field)
    notes = [*_other_sensor(origin, gathered), *gathered.complaints()]
    slow = gathered.gathering.slow_field
    notes += [words for words in (slow, elsewhere) if words]
    notes += [] if course is None else [course.words, *(c.words for c in course.checks)]
    notes += [] if own is None else [own.words]
    try:
        window = gathered.gathering.window()
        result = check(window, calibration, drive=gathered.gathering.drive())
    except Refusal as refusal:
        content = {"summary": str(refusal), "state": None, "about": notes}
        words = f"Too little data: {refusal}.\n{bullets('About the recording:', notes)}"
        print(document(content) if options.json else plain_lines(words.rstrip("\n")))
        return Exit.TOO_LITTLE_DATA
    outcome = Outcome(result.verdict, calibration, result.estimate)
    report = write_report(folder, _subject(window, outcome, options, gathered))
    reference = gathered.reference.facts
    facts = {**_facts(result, notes), "reference": reference, "report": str(report)}
    facts["course"] = None if course is None else course.facts()
    words = f"{_words(result, notes)}\n\nReport: {report}"
    print(document(facts) if options.json else plain_lines(words))
    return Exit.REFUSED if not result.verdict.accepted else Exit.GOOD


def _subject(
    window: Window, outcome: Outcome, options: argparse.Namespace, gathered: Gathered
) -> Subject:
    assert outcome.estimate is not None
    return Subject(
        window,
        Knowledge(gathered.reference.field),
        outcome,
        source=f"{plain(str(options.recording))}, checked against "
        f"{plain(str(options.calibration))}",
        method=outcome.estimate.method,
        title="Compass check",
        magnetometer_frame=gathered.field_frame,
        imu_frame=gathered.imu_frame,
    )


def _other_sensor(origin: Origin, gathered: Gathered) -> list[str]:
    made_for, heard = origin.magnetometer_frame, gathered.field_frame
    if made_for and heard and made_for != heard:
        return [
            f"the calibration was made for the magnetometer {plain(made_for)}, "
            f"but this is {plain(heard)}"
        ]
    return []


def _words(result: Recheck, notes: list[str]) -> str:
    rows = [("", "raw", "corrected", "unit", "")]
    rows += [
        (f.name, _number(f.before), _number(f.value), f.unit, STATES[f.grade])
        for f in result.findings
    ]
    text = f"{result.verdict.summary}\n\n{table(rows)}\n"
    text += bullets("Not shown by this recording:", result.verdict.not_shown)
    text += bullets("About the recording:", notes)
    return text.rstrip("\n")


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _facts(result: Recheck, notes: list[str]) -> dict[str, Any]:
    return {
        "summary": result.verdict.summary,
        "state": result.state,
        "findings": [
            {
                "figure": f.key,
                "state": STATES[f.grade],
                "before": f.before,
                "after": f.value,
                "unit": f.unit,
                "words": f.words,
            }
            for f in result.findings
        ],
        "not_shown": list(result.verdict.not_shown),
        "about": notes,
    }
