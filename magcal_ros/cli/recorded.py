"""What the commands on recordings share: their options, the reading, the progress line."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from magcal_ros.core.errors import Misuse
from magcal_ros.core.knowledge import (
    INCLINATION_SIGMA_DEG,
    STRENGTH_SIGMA_UT,
    Knowledge,
    knowledge_of,
)
from magcal_ros.core.offline import Gathering, Reading
from magcal_ros.files.sources import Source, open_recording

LOOK_EVERY = 2000
"""Messages between two looks at the clock."""

REDRAW = 0.2
LINE_EVERY = 5.0
"""Seconds between two progress lines: on a terminal, where they overwrite, and elsewhere."""


@dataclass(frozen=True, eq=False)
class Gathered:
    """A recording that was read.

    Parameters
    ----------
    gathering : Gathering
        Everything it held.
    imu_topic, field_topic : str
        As recorded, fit to be shown.
    imu_frame, field_frame : str
        `frame_id` of the two sensors; empty if there is none.
    """

    gathering: Gathering
    imu_topic: str
    field_topic: str
    imu_frame: str
    field_frame: str


def add_recording_options(parser: argparse.ArgumentParser, *, several: bool = False) -> None:
    """Add the recording, or several as `recordings`, and which part of it to read."""
    kinds = "rosbag2 (folder, .mcap, .db3), ROS 1 bag, or a folder with imu.csv and mag.csv"
    if several:
        parser.add_argument(
            "recordings",
            type=Path,
            nargs="+",
            metavar="recording",
            help=f"{kinds}; turns of several recordings are joined",
        )
    else:
        parser.add_argument("recording", type=Path, help=kinds)
    parser.add_argument("--imu", default="", metavar="TOPIC", help="the Imu topic of a bag")
    parser.add_argument("--mag", default="", metavar="TOPIC", help="its MagneticField topic")
    parser.add_argument(
        "--from",
        dest="start",
        type=_number(0.0, math.inf),
        default=0.0,
        metavar="SECONDS",
        help="leave out what comes before, counted from the recording's beginning",
    )
    parser.add_argument(
        "--to",
        dest="stop",
        type=_number(0.0, math.inf),
        default=math.inf,
        metavar="SECONDS",
        help="leave out what comes after",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def add_knowledge_options(parser: argparse.ArgumentParser) -> None:
    """Add what may be known beforehand; ranges and defaults are the node's."""
    group = parser.add_argument_group("what is known (each may be left out)")

    def add(name: str, low: float, high: float, default: float, words: str) -> None:
        group.add_argument(
            name, type=_number(low, high), default=default, metavar="NUMBER", help=words
        )

    add("--reference-strength-ut", 15.0, 100.0, math.nan, "strength of the Earth's field, µT")
    add("--reference-strength-sigma-ut", 0.0, 100.0, STRENGTH_SIGMA_UT, "how sure (1 σ), µT")
    add("--reference-inclination-deg", -90.0, 90.0, math.nan, "inclination, positive down, °")
    add("--reference-inclination-sigma-deg", 0.0, 90.0, INCLINATION_SIGMA_DEG, "how sure, °")
    add("--reference-declination-deg", -180.0, 180.0, math.nan, "declination, positive east, °")
    for name, low, high, default, words in (
        ("--soft-iron-gains", 0.1, 10.0, 1.0, "known gains of the magnetometer's axes"),
        ("--mount-rpy-deg", -360.0, 360.0, 0.0, "its nominal pose in the IMU's frame, °"),
    ):
        group.add_argument(
            name,
            type=_number(low, high),
            nargs=3,
            default=[default] * 3,
            metavar=("X", "Y", "Z") if "gains" in name else ("ROLL", "PITCH", "YAW"),
            help=words,
        )


def knowledge_from(options: argparse.Namespace) -> Knowledge:
    """Build what is known from the options."""
    return knowledge_of(
        options.reference_strength_ut,
        options.reference_strength_sigma_ut,
        options.reference_inclination_deg,
        options.reference_inclination_sigma_deg,
        options.reference_declination_deg,
        options.soft_iron_gains,
        options.mount_rpy_deg,
    )


def gather(
    options: argparse.Namespace, knowledge: Knowledge, recording: Path | None = None
) -> Gathered:
    """Read the recording, or the one of `options`, with progress on stderr.

    Raises
    ------
    FileTrouble
        If it cannot be read.
    Misuse
        If the topics or the span are not clear.
    """
    if not options.start < options.stop:
        raise Misuse(f"--from {options.start:g} must come before --to {options.stop:g}")
    chosen = {"imu": options.imu, "field": options.mag}
    span = {"start": options.start, "stop": options.stop}
    path = options.recording if recording is None else recording
    with open_recording(path, **chosen, **span) as source:
        gathering = Gathering(knowledge.mounting, source.imu_topic, source.field_topic)
        gathering.take(watched(source, sys.stderr))
        return Gathered(
            gathering,
            source.imu_topic,
            source.field_topic,
            source.imu_frame,
            source.field_frame,
        )


def watched(
    source: Source, out: TextIO, clock: Callable[[], float] = time.monotonic
) -> Iterator[Reading]:
    """Yield a source's readings, and tell how far it is.

    On a terminal one line is drawn again and removed at the end; elsewhere a line comes now and
    then, so that a short read says nothing.
    """
    terminal = out.isatty()
    pause = REDRAW if terminal else LINE_EVERY
    due, drawn = clock() + pause, False
    for count, reading in enumerate(source.readings()):
        if count % LOOK_EVERY == 0 and clock() >= due:
            line = f"reading: {100.0 * source.share:3.0f} %, {count} messages"
            print(f"\r{line}" if terminal else line, end="" if terminal else "\n", file=out)
            out.flush()
            due, drawn = clock() + pause, True
        yield reading
    if drawn and terminal:
        print("\r\x1b[K", end="", file=out, flush=True)


def _number(low: float, high: float) -> Callable[[str], float]:
    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"must lie between {low:g} and {high:g}, not {text}")
        return value

    return parse
