"""Shared by the commands on recordings: options, known headings, reading, progress line."""

from __future__ import annotations

import argparse
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from magcal_ros.cli.common import add_reference_options, number, reference_in_use
from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.earth_field.reference import Reference
from magcal_ros.core.errors import UsageError
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.core.knowledge import Knowledge, Mounting
from magcal_ros.core.samples.samples_tuning import COMPLAINTS
from magcal_ros.core.samples.streams import DropReason
from magcal_ros.core.session.external_heading import ExternalHeading
from magcal_ros.core.session.recorded import (
    SampleCollector,
    fit_at_headings,
    fit_heading_topic,
    pairs_at_rest,
)
from magcal_ros.files.sources import RepairedReadings, Source, open_recording

REDRAW = 0.2
LINE_EVERY = 5.0
"""Seconds between two progress lines: on a terminal, where one line is redrawn, and elsewhere."""


@dataclass(frozen=True, eq=False)
class CollectedRecording:
    """A recording that was read."""

    collector: SampleCollector
    source: Source  # closed; only its attributes can be used
    reference: Reference
    repaired: RepairedReadings  # read to the end

    def complaints(self) -> list[str]:
        """Return the faults of the recording and of the reference field, in words."""
        found = [*self.source.notes, *self.repaired.notes, *self.collector.complaints()]
        repeats = self.collector.streams.field_drops[DropReason.REPEATED]
        fields = self.repaired.read[1]
        if repeats > COMPLAINTS.worth_a_word * fields:
            words = f"{repeats} of {fields} samples repeat the previous one and are left out"
            found.append(f"{self.source.field_topic}: {words}")
        return [*found, *self.reference.complaints]


RECORDINGS = (
    "rosbag2 (folder, .mcap, .db3), ROS 1 bag, a folder with imu.csv and mag.csv (and odom.csv, "
    "gps.csv), a log of ArduPilot (.BIN, .log, .tlog) or PX4 (.ulg), or the unpacked folder of a "
    "phone's Sensor Logger or phyphox"
)
ANGLES, DEGREES = ("ROLL", "PITCH", "YAW"), number(-360.0, 360.0)
"""Names of three angles in the help, and the parser of an angle."""
USUAL_SIGMA_DEG = 2.0  # of a heading that a person gives


def add_recording_options(
    parser: argparse.ArgumentParser, *, several: bool = False, optional: bool = False
) -> None:
    """Add the recording, or several as `recordings`, and the options for topics and span."""
    name, count = ("recordings", "+") if several else ("recording", "?" if optional else None)
    words = f"{RECORDINGS}; turns of several recordings are joined" if several else RECORDINGS
    parser.add_argument(name, type=Path, nargs=count, metavar="recording", help=words)
    imu, field = "Imu topic of a bag, or IMU[1] of a log", "field topic; MAG[1] of a log"
    parser.add_argument("--imu", default="", metavar="TOPIC", help=imu)
    parser.add_argument("--mag", default="", metavar="TOPIC", help=field)
    words = "pose of a log's or phone's sensors in the vehicle, ° (not of a bag)"
    parser.add_argument("--imu-rpy-deg", type=DEGREES, nargs=3, metavar=ANGLES, help=words)
    span: dict[str, Any] = {"type": number(0.0, math.inf), "metavar": "SECONDS"}
    before = "leave out the part before this time, counted from the start of the recording"
    after = "leave out the part after this time"
    parser.add_argument("--from", dest="start", default=0.0, help=before, **span)
    parser.add_argument("--to", dest="stop", default=math.inf, help=after, **span)
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def add_knowledge_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for prior knowledge, with the ranges and defaults of the node."""
    add_reference_options(parser)
    group = parser.add_argument_group("the sensor (all optional)")
    gain, axes = number(0.1, 10.0), ("X", "Y", "Z")
    words = "known gains of the magnetometer's axes"
    group.add_argument(
        "--soft-iron-gains", type=gain, nargs=3, default=[1.0] * 3, metavar=axes, help=words
    )
    words = "nominal pose of the magnetometer in the IMU's frame, °"
    group.add_argument(
        "--mount-rpy-deg", type=DEGREES, nargs=3, default=[0.0] * 3, metavar=ANGLES, help=words
    )
    words = "yaw of the IMU in the vehicle, to the left of the vehicle's front, °"
    group.add_argument("--vehicle-yaw-deg", type=DEGREES, default=0.0, metavar="YAW", help=words)


def mounting_from(options: argparse.Namespace) -> Mounting:
    """Return the mounting of the sensor by the options."""
    pose = rotation_from_rpy(*map(math.radians, options.mount_rpy_deg))
    in_vehicle = rotation_from_rpy(0.0, 0.0, math.radians(options.vehicle_yaw_deg))
    return Mounting(options.soft_iron_gains, pose, forward=in_vehicle[0])


def opened(options: argparse.Namespace, recording: Path) -> AbstractContextManager[Source]:
    """Open a recording with the topics and the span of the options."""
    if not options.start < options.stop:
        raise UsageError(f"--from {options.start:g} must come before --to {options.stop:g}")
    chosen = {"imu": options.imu, "field": options.mag}
    span = {"start": options.start, "stop": options.stop}
    angles = options.imu_rpy_deg
    pose = None if angles is None else rotation_from_rpy(*map(math.radians, angles))
    shares = [0.0]
    with with_progress(lambda: f"reading, {100.0 * shares[-1]:.0f}%"):
        return open_recording(recording, **chosen, **span, imu_pose=pose, progress=shares.append)


def collect(
    options: argparse.Namespace,
    mounting: Mounting,
    source: Source,
    known: Calibration | None = None,
) -> CollectedRecording:
    """Read a recording, with progress on stderr, and determine its reference field.

    The field of the motors in the calibration `known` is subtracted. Raises Refusal if the IMU is
    too slow.
    """
    collector = SampleCollector(mounting, source.imu_topic, source.field_topic)
    repaired = RepairedReadings(source, known=known)
    with with_progress(lambda: f"reading, {100.0 * repaired.share:.0f}%"):
        # After the field of the motors is subtracted, the current has no further effect.
        collector.take(repaired, source.travel, source.currents if known is None else ())
    newest = collector.streams.field_stamps.newest
    reference = reference_in_use(options, source.place, newest)
    return CollectedRecording(collector, source, reference, repaired)


@contextmanager
def with_progress(words: Callable[[], str], out: TextIO | None = None) -> Iterator[None]:
    """Show the progress and the duration of a long operation, by default on stderr.

    On a terminal, one line is redrawn and removed at the end. Elsewhere, new lines are printed
    every few seconds, so that a short operation prints nothing.
    """
    out = sys.stderr if out is None else out
    is_terminal, started, done = out.isatty(), time.monotonic(), threading.Event()
    begin, end, pause = ("\r", "\x1b[K", REDRAW) if is_terminal else ("", "\n", LINE_EVERY)

    def tell() -> None:
        printed = ""
        while not done.wait(pause):
            seconds, now = time.monotonic() - started, words()
            if is_terminal or now != printed:
                print(f"{begin}{now}: {seconds:.0f} s", end=end, file=out, flush=True)
            printed = now

    teller = threading.Thread(target=tell, name="at work", daemon=True)
    teller.start()
    try:
        yield
    finally:
        done.set()
        teller.join()
        if is_terminal and time.monotonic() - started > pause:
            print("\r\x1b[K", end="", file=out, flush=True)


def add_heading_options(parser: Any) -> None:
    """Add the options for known headings."""
    known = parser.add_argument_group("known headings, in place of a turn")
    known.add_argument(
        "--heading-deg",
        type=DEGREES,
        nargs="+",
        metavar="YAW",
        help="heading of the IMU's x axis at rest in each recording: ENU yaw, 0 to the east, 90 to "
        "the north, positive to the left",
    )
    known.add_argument(
        "--sigma-deg",
        type=number(0.01, 45.0),
        metavar="SIGMA",
        help=f"standard deviation of the heading, ° (default {USUAL_SIGMA_DEG:g})",
    )
    known.add_argument(
        "--heading-topic",
        default="",
        metavar="TOPIC",
        help="topic in a bag with headings of another device, such as two antennas",
    )
    known.add_argument(
        "--north",
        choices=("true", "magnetic"),
        help="which north these headings refer to; required with headings",
    )


def check_heading_options(options: argparse.Namespace) -> None:
    """Raise UsageError for options that exclude each other."""
    angles, topic = options.heading_deg or (), options.heading_topic
    if not (angles or topic):
        given = {"--north": options.north, "--sigma-deg": options.sigma_deg}
        for option in (name for name, value in given.items() if value is not None):
            raise UsageError(
                f"{option} is only for headings: give --heading-deg or --heading-topic with it"
            )
        return
    if options.north is None:
        raise UsageError("give the north of the headings: --north true or --north magnetic")
    if angles and topic:
        raise UsageError("give --heading-deg or --heading-topic, not both")
    if topic and options.sigma_deg is not None:
        raise UsageError("--sigma-deg is for --heading-deg: the messages of a topic hold their own")
    if angles and len(angles) != len(options.recordings):
        raise UsageError(
            f"{len(angles)} headings for {len(options.recordings)} recordings: give one "
            "--heading-deg for each recording, in the same order, after the recordings"
        )
    if topic and len(options.recordings) > 1:
        raise UsageError("--heading-topic takes one recording")
    if options.compare:
        raise UsageError("--compare is for turns only: there is one method for known headings")


def fit_known(options: argparse.Namespace, knowledge: Knowledge) -> Outcome | None:
    """Calibrate at known headings; None if no headings are given."""
    is_true, topic = options.north == "true", options.heading_topic
    is_given = bool(topic or options.heading_deg)
    if is_given and knowledge.reference.to_magnetic(is_true) is None:
        raise UsageError(
            "headings to true north need the declination: give --latitude and --longitude, or "
            "--reference-declination-deg, or headings to magnetic north with --north magnetic"
        )
    if topic:
        with opened(options, options.recordings[0]) as source:
            readings, headings = tuple(RepairedReadings(source)), tuple(source.headings(topic))
        return fit_heading_topic(readings, headings, is_true, knowledge)
    if not options.heading_deg:
        return None
    pairs = []
    for path in options.recordings:
        with opened(options, path) as source:
            pairs.append(pairs_at_rest(RepairedReadings(source)))
    sigma = math.radians(USUAL_SIGMA_DEG if options.sigma_deg is None else options.sigma_deg)
    given = [ExternalHeading(math.radians(yaw), sigma, is_true) for yaw in options.heading_deg]
    return fit_at_headings(pairs, given, knowledge)
