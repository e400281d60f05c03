"""`magcal check`, `drive` and `export`: a stored calibration with other samples or formats."""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from magcal_ros.cli import common, recorded
from magcal_ros.core.assessment.grading import Check, shown
from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.earth_field.reference import made_elsewhere
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import Knowledge, Mounting
from magcal_ros.core.monitoring.recheck import STATES, Recheck, check
from magcal_ros.core.monitoring.recorded_course import against_own_yaw, recorded_course
from magcal_ros.core.self_calibration.drive_replay import DriveReplay, replay_drive
from magcal_ros.core.session.recorded import SampleCollector, fault_of_drive
from magcal_ros.files.calibration_file import (
    Origin,
    read_calibration,
    require_not_ours,
    write_calibration,
)
from magcal_ros.files.disk import printable, write_atomically
from magcal_ros.files.exporters import EXPORTERS, NOTES, OF_LOGS
from magcal_ros.files.sources import RepairedReadings
from magcal_ros.report import Subject, write_report
from magcal_ros.report.drive_page import VERBS, summary_of, write_drive_page


def add_check(commands: Any) -> None:
    """Add the command's arguments."""
    words = "check with a new recording whether a calibration still holds"
    parser = common.command(commands, "check", run_check, words)
    recorded.add_recording_options(parser)
    parser.add_argument(
        "--calibration", type=Path, required=True, metavar="FILE", help="the calibration"
    )
    common.add_output_option(parser, "the report", "magcal_check")
    common.add_reference_options(parser)


def run_check(options: argparse.Namespace) -> int:
    """Check whether a calibration is still valid, with a new recording in which the robot turns.

    Exit status: 0 the calibration holds or is doubtful (see the output), 2 usage, 3 too little or
    too uncertain data, 4 the calibration is stale, 5 file trouble.
    """
    calibration, origin = read_calibration(options.calibration)
    with recorded.opened(options, options.recording) as source:
        recording = recorded.collect(options, Mounting(), source, calibration)
        north = recording.reference.field.declination
        travel, readings = source.travel, RepairedReadings(source, known=calibration)
        course = recorded_course(calibration, readings, travel, north) if travel else None
        own = against_own_yaw(calibration, readings, source.yaw, north)
    folder = common.new_or_named(options.output, "magcal_check")
    elsewhere = made_elsewhere(calibration, recording.reference.field)
    frame = recording.source.field_frame
    by_course = "" if course is None else course.words
    notes = [*_of_another_sensor(origin, frame), *recording.complaints()]
    notes += filter(None, (recording.collector.slow_field, elsewhere, by_course, own))
    try:
        with recorded.with_progress(lambda: "checking"):
            window = recording.collector.window(recording.reference.field)
            result = check(window, calibration, drive=recording.collector.drive())
    except Refusal as refusal:
        content = {"summary": str(refusal), "state": None, "about": notes}
        words = f"Too little data: {refusal}.\n{common.bullets('About the recording:', notes)}"
        common.tell_result(content, words.rstrip("\n"), as_json=options.json)
        return common.Exit.TOO_LITTLE_DATA
    outcome = Outcome(result.verdict, calibration, result.estimate)
    subject = Subject(
        window,
        Knowledge(recording.reference.field),
        outcome,
        source=f"{printable(str(options.recording))}, checked against "
        f"{printable(str(options.calibration))}",
        method=result.estimate.method,
        title="Compass check",
        magnetometer_frame=frame,
        imu_frame=recording.source.imu_frame,
    )
    report = None
    try:
        with recorded.with_progress(lambda: "writing the report"):
            report = str(write_report(folder, subject))
    finally:  # an error must not hide the result
        facts = _facts(result, notes) | {
            "reference": recording.reference.facts,
            "report": report,
            "course": None if course is None else course.facts(),
        }
        words = f"{_words(result, notes)}\n\n" + (f"Report: {report}" if report else "No report.")
        common.tell_result(facts, words, as_json=options.json)
    if not result.verdict.accepted:
        return common.Exit.REFUSED
    return common.Exit.GOOD if result.is_judged else common.Exit.TOO_LITTLE_DATA


def _of_another_sensor(origin: Origin | None, frame: str) -> list[str]:
    """Say that the calibration is of another magnetometer than the recording; empty if not."""
    made_for = "" if origin is None else origin.magnetometer_frame
    if not made_for or not frame or made_for == frame:
        return []
    names = f"made for the magnetometer {printable(made_for)}, but this is {printable(frame)}"
    return [f"the calibration was {names}"]


NOT_JUDGED = "This recording does not show whether the calibration holds."


def _words(result: Recheck, notes: list[str]) -> str:
    against = [f for f in result.findings if STATES[f.grade] != "holds"]
    measured = [finding for finding in result.findings if finding.bound is not None]
    found = [_row(finding) for finding in measured]
    by_chance = [f for f, row in zip(measured, found, strict=True) if row[-1] == "chance"]
    title = f"{result.sentence}." if result.is_judged else NOT_JUDGED
    rows = [("", "raw", "corrected", "want", "stale", ""), *found]
    text = f"{title}\n\n{common.table(rows)}\n"
    text += common.bullets(
        "What contradicts the calibration:", [f.words for f in against if f.is_judged]
    )
    text += common.bullets("Outside the wanted range:", [f.words for f in by_chance])
    text += common.bullets("Too uncertain to judge:", [f.words for f in against if not f.is_judged])
    text += common.bullets("Not shown by this recording:", result.verdict.not_shown)
    text += common.bullets("About the recording:", notes)
    return text.rstrip("\n")


def _row(finding: Check) -> tuple[str, ...]:
    """Return name, raw and corrected value, the limits for wanted and stale, and the state."""
    bound, value, unit = finding.bound, finding.value, finding.unit
    # The findings of a recheck have both.
    assert bound is not None
    assert value is not None
    state = STATES[finding.grade] if finding.is_judged else "unclear"
    if state == "holds" and value > bound.good:
        state = "chance"
    raw = "" if finding.before is None else shown(finding.before)
    limits = f"≤ {bound.good:g}{unit}", f"> {bound.warn:g}{unit}"
    return (finding.name.removesuffix(" by"), raw, shown(value), *limits, state)


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


def add_drive(commands: Any) -> None:
    """Add the command's arguments."""
    words = "evaluate the compass on a recorded drive"
    parser = common.command(commands, "drive", run_drive, words)
    recorded.add_recording_options(parser)
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE", help="in force at the start (default: none)"
    )
    common.add_output_option(parser, "the report", "magcal_drive")
    recorded.add_knowledge_options(parser)


NO_GYRO = (
    "the recording has no gyro, but `drive` needs one, because the field changes along the drive; "
    "`fit` accepts a turn without a gyro"
)


TOO_SHORT = "the recording, or the span of it, is too short for a drive: record some minutes"


def run_drive(options: argparse.Namespace) -> int:
    """Replay a recorded drive, and show the decisions of self-calibration with their reasons.

    The replay is as with `self_calibration: apply`; the node's default, `propose`, waits for
    ~/accept. A map shows where the field is disturbed. Exit status: 0 a calibration is in force at
    the end, 2 usage, 3 no calibration is in force, 5 file trouble.
    """
    given = options.calibration
    initial, made = (None, None) if given is None else read_calibration(given)
    folder = common.new_or_named(options.output, "magcal_drive")
    with recorded.opened(options, options.recording) as source:
        reference = common.reference_in_use(options, source.place, source.first_stamp)
        knowledge = Knowledge(reference.field, recorded.mounting_from(options))
        repaired = RepairedReadings(source, for_drive=True, known=initial)
        travel = source.travel
        with recorded.with_progress(
            lambda: f"fitting the drive, {100.0 * repaired.share:.0f}% of it"
        ):
            replay = replay_drive(knowledge, initial, repaired, travel)
            if replay.last_calibration is None:
                collector = SampleCollector(
                    knowledge.mounting, source.imu_topic, source.field_topic
                )
                collector.take(repaired, travel)
                replay = replace(replay, fault=fault_of_drive(collector, knowledge))
        if not replay.seconds > 0.0:
            no_gyro = math.isnan(replay.seconds) and all(repaired.read)
            raise Refusal(Reason.TOO_FEW_SAMPLES, NO_GYRO if no_gyro else TOO_SHORT)
        if replay.last_calibration is not None and travel:
            north = reference.field.declination
            course = recorded_course(replay.last_calibration, repaired, travel, north)
            replay = replace(replay, course="" if course is None else course.words)
    page = write_drive_page(folder, replay, printable(str(options.recording)))
    files = [page]
    if replay.last_calibration is not None and replay.last_calibration is not initial:
        files.append(folder / common.CALIBRATION)
        origin = Origin.now(source.field_frame, source.imu_frame)
        write_calibration(files[-1], replay.last_calibration, origin, remedy=common.REMEDY)
    notes = [*_of_another_sensor(made, source.field_frame), *source.notes, *repaired.notes]
    notes = list(dict.fromkeys(notes))
    content = replay, notes, files
    common.tell_result(_drive_facts(*content), _drive_words(*content), as_json=options.json)
    return common.Exit.TOO_LITTLE_DATA if replay.last_calibration is None else common.Exit.GOOD


def _drive_words(replay: DriveReplay, notes: list[str], files: list[Path]) -> str:
    lines = [common.with_options(summary_of(replay))]
    lines += [f"At the end: {replay.course}."] if replay.course else []
    lines += [f"{at:6.0f} s  {VERBS[made.kind]}: {made.words}" for at, made in replay.decisions]
    lines += common.bullets("About the recording:", notes).strip("\n").splitlines()
    return "\n".join([*lines, *(f"Written: {file}" for file in files)])


def _drive_facts(replay: DriveReplay, notes: list[str], files: list[Path]) -> dict[str, Any]:
    return {
        "summary": summary_of(replay),
        "course": replay.course or None,
        "decisions": [
            {"at_s": round(at, 1), "decision": made.kind.value, "why": made.words}
            for at, made in replay.decisions
        ],
        "about": notes,
        "files": [str(file) for file in files],
    }


def add_export(commands: Any) -> None:
    """Add the command's arguments."""
    parser = common.command(
        commands, "export", run_export, "write a calibration for another program"
    )
    parser.add_argument("calibration", type=Path, help="a calibration file of this package")
    parser.add_argument(
        "--to", required=True, choices=sorted(EXPORTERS), metavar="NAME", help=", ".join(EXPORTERS)
    )
    parser.add_argument("--output", type=Path, help="the file to write (default: print it)")


def run_export(options: argparse.Namespace) -> int:
    """Write a calibration in the format of another program.

    A comment names the parts that this program cannot store. The export is refused if the heading
    of this program would be wrong.
    """
    calibration, origin = read_calibration(options.calibration)
    about = [origin.magnetometer_frame] if options.to in OF_LOGS else []
    text = EXPORTERS[options.to](calibration, *about)
    if options.output is None:
        print(text, end="")
    else:
        require_not_ours(options.output)
        write_atomically(options.output, text, common.REMEDY)
    if options.to in NOTES:
        print(f"magcal: {options.to}: {NOTES[options.to]}", file=sys.stderr)
    return common.Exit.GOOD
