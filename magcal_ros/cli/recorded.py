"""What the commands on recordings share: their options, the reading, the progress line."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from magcal_ros.cli.common import number
from magcal_ros.cli.reference import add_reference_options, reference_in_use
from magcal_ros.core.earth_field.reference import Reference
from magcal_ros.core.errors import Misuse
from magcal_ros.core.knowledge import Mounting, knowledge_of
from magcal_ros.core.session.recorded import Gathering, Reading
from magcal_ros.files.mended import MendedReadings
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
    reference : Reference
        The reference field at its place and date.
    mended : list of str
        What was mended in it, in words.
    """

    gathering: Gathering
    imu_topic: str
    field_topic: str
    imu_frame: str
    field_frame: str
    reference: Reference
    mended: list[str]

    def complaints(self) -> list[str]:
        """Return everything that is wrong with it, or with what was said about it."""
        return [*self.mended, *self.gathering.complaints(), *self.reference.complaints]


def add_recording_options(
    parser: argparse.ArgumentParser, *, several: bool = False, optional: bool = False
) -> None:
    """Add the recording, or several as `recordings`, and which part of it to read."""
    kinds = (
        "rosbag2 (folder, .mcap, .db3), ROS 1 bag, or a folder with imu.csv and mag.csv (and "
        "odom.csv, gps.csv)"
    )
    if several:
        parser.add_argument(
            "recordings",
            type=Path,
            nargs="+",
            metavar="recording",
            help=f"{kinds}; turns of several recordings are joined",
        )
    else:
        many = "?" if optional else None
        parser.add_argument("recording", type=Path, nargs=many, help=kinds)
    parser.add_argument("--imu", default="", metavar="TOPIC", help="the Imu topic of a bag")
    parser.add_argument("--mag", default="", metavar="TOPIC", help="its MagneticField topic")
    parser.add_argument(
        "--from",
        dest="start",
        type=number(0.0, math.inf),
        default=0.0,
        metavar="SECONDS",
        help="leave out what comes before, counted from the recording's beginning",
    )
    parser.add_argument(
        "--to",
        dest="stop",
        type=number(0.0, math.inf),
        default=math.inf,
        metavar="SECONDS",
        help="leave out what comes after",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def add_knowledge_options(parser: argparse.ArgumentParser) -> None:
    """Add what may be known beforehand; ranges and defaults are the node's."""
    add_reference_options(parser)
    group = parser.add_argument_group("the sensor (each may be left out)")
    for name, low, high, default, words in (
        ("--soft-iron-gains", 0.1, 10.0, 1.0, "known gains of the magnetometer's axes"),
        ("--mount-rpy-deg", -360.0, 360.0, 0.0, "its nominal pose in the IMU's frame, °"),
    ):
        group.add_argument(
            name,
            type=number(low, high),
            nargs=3,
            default=[default] * 3,
            metavar=("X", "Y", "Z") if "gains" in name else ("ROLL", "PITCH", "YAW"),
            help=words,
        )


def mounting_from(options: argparse.Namespace) -> Mounting:
    """Return how the sensor is built in, by the options."""
    gains, angles = options.soft_iron_gains, options.mount_rpy_deg
    return knowledge_of(soft_iron_gains=gains, mount_rpy_deg=angles).mounting


def opened(options: argparse.Namespace, recording: Path) -> AbstractContextManager[Source]:
    """Open a recording: those topics and that part of it which the options name.

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
    return open_recording(recording, **chosen, **span)


def gather(options: argparse.Namespace, mounting: Mounting, recording: Path) -> Gathered:
    """Read a recording, with progress on stderr, and find its reference field.

    Raises
    ------
    FileTrouble
        If it cannot be read.
    Misuse
        If the topics or the span are not clear.
    """
    with opened(options, recording) as source:
        gathering = Gathering(mounting, source.imu_topic, source.field_topic)
        mended = MendedReadings(source)
        gathering.take(watched(source, mended, sys.stderr), source.travel())
        return Gathered(
            gathering,
            source.imu_topic,
            source.field_topic,
            source.imu_frame,
            source.field_frame,
            reference_in_use(options, source.place(), gathering.streams.field_stamps.newest),
            mended.notes,
        )


def watched(
    source: Source,
    readings: Iterable[Reading],
    out: TextIO,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[Reading]:
    """Yield what is read of a source, and tell how far it is.

    On a terminal one line is drawn again and removed at the end; elsewhere a line comes now and
    then, so that a short read says nothing.
    """
    terminal = out.isatty()
    pause = REDRAW if terminal else LINE_EVERY
    due, drawn = clock() + pause, False
    for count, reading in enumerate(readings):
        if count % LOOK_EVERY == 0 and clock() >= due:
            line = f"reading: {100.0 * source.share:3.0f} %, {count} messages"
            print(f"\r{line}" if terminal else line, end="" if terminal else "\n", file=out)
            out.flush()
            due, drawn = clock() + pause, True
        yield reading
    if drawn and terminal:
        print("\r\x1b[K", end="", file=out, flush=True)
