"""The command `magcal`."""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Sequence

from magcal_ros import __version__
from magcal_ros.cli import calibrate, check, demo, export, fit, replay
from magcal_ros.cli.exits import Exit
from magcal_ros.core.errors import MagcalError, Misuse
from magcal_ros.files.atomic import FileTrouble

COMMANDS = (calibrate, fit, check, export, replay, demo)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit status, and puts known errors into one line."""
    parser = argparse.ArgumentParser(
        prog="magcal", description="Calibrate a ground robot's magnetometer from one turn."
    )
    parser.add_argument("--version", action="version", version=f"magcal_ros {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in COMMANDS:
        command.add_to(commands)
    options = parser.parse_args(arguments)
    for stream in (sys.stdout, sys.stderr):
        # A path may hold any bytes, and a terminal may know no "µ": neither ends a command.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        return int(options.run(options))
    except KeyboardInterrupt:
        return int(Exit.INTERRUPTED)
    except Misuse as error:
        print(f"magcal: {error}", file=sys.stderr)
        return int(Exit.USAGE)
    except FileTrouble as error:
        print(f"magcal: {error}", file=sys.stderr)
        return int(Exit.FILE_TROUBLE)
    except MagcalError as error:
        print(f"magcal: {error}", file=sys.stderr)
        return int(Exit.FAILED)


if __name__ == "__main__":
    sys.exit(main())
