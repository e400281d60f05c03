"""`magcal doctor`: faults of the sensors, live or recorded, with remedies."""

from __future__ import annotations

import argparse
import math
import select
import shlex
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magcal_ros.cli import recorded
from magcal_ros.cli.common import Exit, bullets, command, reference_in_use, tell_result
from magcal_ros.cli.live_view import interrupts_noted, joined
from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.doctor.doctor_tuning import HEALTH
from magcal_ros.core.doctor.finding import Finding, ok_or_severe, ok_or_warning, undetermined
from magcal_ros.core.doctor.guide import ASKED, Guide
from magcal_ros.core.doctor.sensor_report import SensorReport, examine
from magcal_ros.core.errors import MagcalError, UsageError
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import usual_size
from magcal_ros.core.geometry.frame_tree import pose_in_words
from magcal_ros.core.knowledge import Belief, Knowledge, ReferenceField
from magcal_ros.core.monitoring.recorded_course import RecordedCourse, recorded_course
from magcal_ros.core.samples.streams import FieldSample, ImuSample, TravelSample
from magcal_ros.core.samples.units import likely_field_unit
from magcal_ros.core.samples.window import SensorLog
from magcal_ros.core.session.recorded import Reading, SampleCollector
from magcal_ros.files.disk import FileError, printable, write_atomically
from magcal_ros.files.exporters import parameter_file
from magcal_ros.files.recording import REMEDY
from magcal_ros.files.wire import FIELD_TYPE, IMU_TYPE

if TYPE_CHECKING:
    from magcal_ros.ros.preflight import Listener


MOST_SAMPLES = 500_000  # samples kept of each stream: more than an hour at 100 Hz


def add_doctor(commands: Any) -> None:
    """Add the command's arguments."""
    words = "find what is wrong with the sensors, live or in a recording"
    parser = command(commands, "doctor", run, words)
    recorded.add_recording_options(parser, optional=True)
    parser.add_argument(
        "--live", action="store_true", help="listen to the running sensors (without a recording)"
    )
    parser.add_argument(
        "--turned",
        choices=("left", "right"),
        help=(
            "direction in which the robot turned in the recording; needed to detect that all "
            "sensors are upside down"
        ),
    )
    parser.add_argument(
        "--write", type=Path, metavar="FILE", help="write the corrections as a parameter file"
    )
    recorded.add_knowledge_options(parser)


@dataclass(frozen=True, eq=False)
class DoctorInput:
    """The samples of a recording or of the guided half minute, with further knowledge."""

    samples: list[ImuSample | FieldSample]
    knowledge: Knowledge  # given by the user, or the pose by the robot's description
    turned_left: bool | None  # whether the robot turned to the left; None if unknown
    more: tuple[Finding, ...]  # findings that are not from the samples
    described: str = ""  # the pose by the robot's description, in words; empty if not used
    travel: Sequence[TravelSample] = ()

    def report_of(self, log: SensorLog) -> SensorReport:
        """Return all findings, also from the comparison with course and description."""
        report = examine(log, self.knowledge, self.turned_left)
        given = [f.remedy for f in report.findings if f.remedy]
        # A complaint that a line of the report contains already is left out.
        more = [f for f in self.more if not any(words in f.evidence for words in given)]
        report = report.with_more(more)
        if self.travel and report.compass is not None:
            course = recorded_course(report.compass, self.samples, self.travel)
            report = report.with_course(*_course_seen(course, self.knowledge.reference))
        return report.with_more((self._description(report),)) if self.described else report

    def _description(self, report: SensorReport) -> Finding:
        """Compare the described pose of the magnetometer with the measured one."""
        described = f"magnetometer at {self.described}"
        if report.mount_rpy_deg is not None:
            radians = " ".join(f"{math.radians(angle):.4g}" for angle in report.mount_rpy_deg)
            return ok_or_severe(
                "description",
                "description",
                f"{described}, but measured differently",
                f'set rpy="{radians}" in the URDF joint between IMU and magnetometer',
            )
        if any(f.key in AXIS_FAULTS and f.is_wrong for f in report.findings):
            words = f"{described}; correct the axes first"
            return undetermined("description", "description", words)
        return ok_or_warning("description", "description", described)


def run(options: argparse.Namespace) -> int:
    """Find faults of the sensors, and their remedies.

    The command checks stamps, latency, units, gravity, repeats, resolution, range, noise and axes.
    Without a recording it guides the user for half a minute with the running sensors: stand still,
    turn left, lift the nose. Exit status: 0 nothing is wrong (but some lines may need a look),
    2 usage, 3 too little data, 4 something is wrong, 5 file trouble.
    """
    if options.write is not None and options.write.exists():
        raise FileError(f"{options.write} exists already: name another --write")
    if options.recording is not None and options.live:
        raise UsageError("--live is without a recording: leave out --live, or the recording")
    collected = listen(options) if options.recording is None else _recorded(options)
    log = SensorLog.of(collected.samples)
    if min(len(log.imu_time), len(log.field_time)) >= HEALTH.fewest:
        return _tell(options, collected.report_of(log), collected.knowledge.mounting.gains)
    facts = report_as_facts(SensorReport(collected.more), None, Exit.TOO_LITTLE_DATA)
    streams = (("IMU", log.imu_time), ("field", log.field_time))
    counts = " and ".join(f"{_counted(time)} of the {name}" for name, time in streams)
    words = (
        f"Too little data: {counts}. At least {HEALTH.fewest} of each are needed: record for longer"
    )
    tell_result(facts, f"{words}, or at a higher rate.", as_json=options.json)
    return Exit.TOO_LITTLE_DATA


def _counted(time: FloatArray) -> str:
    """Return the number of samples and their rate, in words."""
    gap = float(np.median(np.diff(time))) if len(time) > 2 else 0.0
    return f"{len(time)} samples" + (f" at {1.0 / gap:.2g} Hz" if gap > 0.0 else "")


def _recorded(options: argparse.Namespace) -> DoctorInput:
    samples: list[ImuSample | FieldSample] = []
    rest = {ImuSample: MOST_SAMPLES, FieldSample: MOST_SAMPLES}

    def kept(readings: Iterator[Reading]) -> Iterator[Reading]:
        for reading in readings:
            if reading is not None and rest[type(reading)] > 0:
                rest[type(reading)] -= 1
                samples.append(reading)
            yield reading

    mounting = recorded.mounting_from(options)
    with recorded.opened(options, options.recording) as source:
        collector = SampleCollector(mounting, source.imu_topic, source.field_topic)
        percent = 100.0 / max(source.count, 1)
        with recorded.with_progress(lambda: f"reading, {percent * sum(collector.received):.0f}%"):
            collector.take(kept(source.readings()))
        newest = collector.streams.field_stamps.newest
        reference = reference_in_use(options, source.place, newest)
        travel = source.travel
    complaints = [*source.notes, *collector.complaints(), *reference.complaints]
    fields = [each.field for each in samples if isinstance(each, FieldSample)]
    if fields and likely_field_unit(usual_size(np.array(fields))):
        # The report has a line on the unit, by the usual size of the field instead of the largest.
        largest = likely_field_unit(collector.streams.largest_field)
        complaints = [words for words in complaints if words != largest]
    more = tuple(ok_or_warning("recording", "recording", words, words) for words in complaints)
    left = None if options.turned is None else options.turned == "left"
    return DoctorInput(samples, Knowledge(reference.field, mounting), left, more, travel=travel)


def _course_seen(course: RecordedCourse | None, field: ReferenceField) -> tuple[Belief, Belief]:
    if course is None:
        return Belief.unknown(), Belief.unknown()
    north, offset, mounting = field.declination or 0.0, course.offset, course.mounting
    yaw, sigma = (0.0, 0.0) if mounting is None else (mounting.yaw, mounting.sigma)
    gap = math.remainder(offset.offset - north - yaw, math.tau)
    imu_yaw = Belief.unknown() if mounting is None else Belief(yaw, sigma)
    return Belief(gap, math.hypot(offset.sigma, sigma)), imu_yaw


def _tell(options: argparse.Namespace, report: SensorReport, gains: FloatArray) -> int:
    """Print the report and write the parameters that correct faults."""
    # Such a fault would make headings wrong.
    is_wrong = any(finding.grade is Grade.REFUSED for finding in report.findings)
    status = Exit.REFUSED if is_wrong else Exit.GOOD
    written = write_parameters(options.write, report, None if np.allclose(gains, 1.0) else gains)
    words = report_in_words(report)
    if written is not None:
        words += (
            f"\n\nWritten: {written}. Start the calibrator with `--params-file "
            f"{shlex.quote(written)}` (after `--ros-args`), and calibrate again."
        )
    elif options.write is not None:
        words += "\n\nNo file is written: no fault was found that a parameter corrects."
    tell_result(report_as_facts(report, written, status), words, as_json=options.json)
    return status


GRADE_MARKS = {Grade.EXCELLENT: "ok", Grade.GOOD: "-", Grade.WARN: "look", Grade.REFUSED: "wrong"}


def report_in_words(report: SensorReport) -> str:
    """Return the report for a terminal: a line for each finding, then the remedies."""
    lines = [
        f"  {GRADE_MARKS[f.grade]:<6}{f.name:<30}{printable(f.evidence, 1000)}"
        for f in report.findings
    ]
    # Several lines may have the same cause.
    remedies: dict[str, list[str]] = {}
    for finding in sorted(report.findings, key=lambda finding: -finding.grade.rank):
        if finding.remedy:
            remedies.setdefault(finding.remedy, []).append(finding.name)
    todo = [
        f"{' and '.join(dict.fromkeys(names))}: {printable(words, 1000)}"
        for words, names in remedies.items()
    ]
    return "\n".join(lines) + bullets("\nWhat to do:", todo).rstrip("\n")


def report_as_facts(report: SensorReport, written: str | None, status: Exit) -> dict[str, Any]:
    """Return the report for programs."""
    return {
        "findings": [asdict(finding) for finding in report.findings],
        "mount_rpy_deg": report.mount_rpy_deg,
        "written": written,
        "exit": int(status),
    }


def write_parameters(
    path: Path | None, report: SensorReport, gains: FloatArray | None
) -> str | None:
    """Write the parameters that correct faults, and the given gains; returns the path.

    No file is written if a mounting alone does not correct the axes: faults of a driver must be
    corrected in the driver.
    """
    if path is None or not report.parameters:
        return None
    lines = [report.parameters]
    if gains is not None:
        lines.append(f"soft_iron_gains: [{', '.join(f'{float(gain)!r}' for gain in gains)}]")
    write_atomically(path, parameter_file(*lines), REMEDY)
    return str(path)


SILENT_AFTER = 8.0  # longest wait for messages of both sensors, seconds

AXIS_FAULTS = (
    "axes",
    "field_axes",
    "gyro_axes",
    "force_axes",
    "nothing_fits",
    "imu_axes",
    "gravity_sign",
)
"""Faults with which the description cannot be checked."""

SEVERAL_PUBLISHERS = (
    "only one node can be the sensor: stop the others, or give one of them another topic; "
    "alternating messages from two sensors look like a field that jumps"
)


def listen(options: argparse.Namespace) -> DoctorInput:
    """Guide the user through the half minute and collect the samples."""
    with joined("magcal_doctor", []) as node:
        from rclpy.executors import SingleThreadedExecutor

        from magcal_ros.ros.preflight import Listener, sensor_topic

        wanted = (IMU_TYPE, options.imu, "--imu"), (FIELD_TYPE, options.mag, "--mag")
        imu, field = (sensor_topic(node, *each) for each in wanted)
        samples: list[ImuSample | FieldSample] = []
        guide = Guide(time.monotonic())

        def take(sample: ImuSample | FieldSample) -> None:
            samples.append(sample)
            guide.add(sample)

        listener = Listener(node, imu, field, take)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        begin = time.monotonic()
        say(f"Listening to {imu} and {field}. The Enter key skips a step.")
        asking = GuidePrompts()
        with interrupts_noted() as interrupted:
            while guide.current is not None and not interrupted.is_set():
                executor.spin_once(timeout_sec=0.02)
                now = time.monotonic()
                asking.count_down(guide, now)
                if asking.is_skipped() and guide.skip(now):
                    asking.tick(guide, missed="skipped")
                if guide.pass_time(now):
                    asking.tick(guide)
                silent = [each.topic for each in listener.sensors if not each.messages]
                if silent and now - begin > SILENT_AFTER:
                    raise MagcalError(
                        f"nothing arrives on {' and '.join(silent)}: check that the driver runs "
                        "and the clock is not paused, or choose other topics with --imu and --mag"
                    )
        if interrupted.is_set():
            raise KeyboardInterrupt
        return gathered(options, listener, samples, guide)


def say(line: str) -> None:
    """Print a line for the user on stderr; only the report goes to standard output."""
    print(line, file=sys.stderr, flush=True)


class GuidePrompts:
    """Prints the steps of the guide and the remaining seconds, and reads the Enter key."""

    def __init__(self) -> None:
        self._rewrites = sys.stderr.isatty()
        self._keys = sys.stdin is not None and sys.stdin.isatty()
        self._shown = ""

    def count_down(self, guide: Guide, now: float) -> None:
        """Show the present step, and the remaining seconds."""
        if guide.current is None:
            return
        line, begin, end = f"  [ ] {ASKED[guide.current]}", "", "\n"
        if self._rewrites:
            line, begin, end = f"{line} ({guide.left(now):.0f} s left)", "\r", "\033[K"
        if line != self._shown:
            self._shown = line
            print(f"{begin}{line}", end=end, file=sys.stderr, flush=True)

    def is_skipped(self) -> bool:
        """Return whether the Enter key was pressed."""
        if not self._keys or not select.select([sys.stdin], [], [], 0.0)[0]:
            return False
        # The end of the input is not a key; without this, it would be read in each call.
        self._keys = bool(sys.stdin.readline())
        return self._keys

    def tick(self, guide: Guide, missed: str = "not detected") -> None:
        """Print whether the last step was detected, and if not, why it ended."""
        last, detected = list(guide.ended.items())[-1]
        over = "\r\033[K" if self._rewrites else ""
        mark, ending = ("x", "") if detected else ("-", f": {missed}")
        say(f"{over}  [{mark}] {ASKED[last]}{ending}")
        self._shown = ""


def gathered(
    options: argparse.Namespace,
    listener: Listener,
    samples: list[ImuSample | FieldSample],
    guide: Guide,
) -> DoctorInput:
    """Return the samples with the knowledge from the user, the graph and the description."""
    newest = max((s.stamp for s in samples if isinstance(s, FieldSample)), default=0.0)
    reference = reference_in_use(options, None, newest)
    mounting, described, pose = recorded.mounting_from(options), "", listener.described_pose
    # A pose that the user gives takes precedence over the description.
    if pose is not None and not any(options.mount_rpy_deg):
        mounting, described = replace(mounting, pose=pose), pose_in_words(pose)
    more = [ok_or_warning("reference", "reference", words, words) for words in reference.complaints]
    more += [
        ok_or_severe("publishers", "publishers", words, SEVERAL_PUBLISHERS)
        for words in listener.several_publishers
    ]
    known = Knowledge(reference.field, mounting)
    return DoctorInput(samples, known, guide.turned_left, tuple(more), described)
