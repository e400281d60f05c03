"""`magcal export`: a stored calibration in the format of another program."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from magcal_ros.cli.common import Exit
from magcal_ros.files.atomic import write_atomically
from magcal_ros.files.calibration_file import read_calibration
from magcal_ros.files.exporters import EXPORTERS, NOTES, OF_LOGS


def add_to(commands: Any) -> None:
    """Add the command's arguments."""
    parser = commands.add_parser(
        "export",
        help="write a calibration for another program",
        description="Write a calibration in the form another program reads. What that program "
        "cannot hold is said in a comment; what would make its heading wrong is refused.",
    )
    parser.add_argument("calibration", type=Path, help="a calibration file of this package")
    parser.add_argument(
        "--to", required=True, choices=sorted(EXPORTERS), metavar="NAME", help=", ".join(EXPORTERS)
    )
    parser.add_argument("--output", type=Path, help="the file to write (default: print it)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Read, translate, write."""
    calibration, origin = read_calibration(options.calibration)
    about = [origin.magnetometer_frame] if options.to in OF_LOGS else []
    text = EXPORTERS[options.to](calibration, *about)
    if options.output is None:
        print(text, end="")
    else:
        write_atomically(options.output, text)
    if options.to in NOTES:
        print(f"magcal: {options.to}: {NOTES[options.to]}", file=sys.stderr)
    return Exit.GOOD
