"""The command `magcal`."""

from __future__ import annotations

import argparse
import errno
import io
import os
import sys
import traceback
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, metadata
from typing import NoReturn

from magcal_ros import __version__
from magcal_ros.cli.calibrate import add_calibrate
from magcal_ros.cli.check import add_check, add_drive, add_export
from magcal_ros.cli.common import Exit, tell
from magcal_ros.cli.demo import add_demo, add_replay
from magcal_ros.cli.doctor import add_doctor
from magcal_ros.cli.fit import add_fit
from magcal_ros.core.errors import MagcalError, Refusal, UsageError
from magcal_ros.files.disk import FileError, printable, printable_lines
from magcal_ros.processes import leave_out_current_folder

COMMANDS = (
    add_calibrate, add_fit, add_check, add_drive, add_doctor, add_export, add_replay, add_demo
)  # fmt: skip


class Parser(argparse.ArgumentParser):
    """A parser whose error messages contain no control characters."""

    def error(self, message: str) -> NoReturn:
        """End the program with a message; argparse quotes some arguments unchanged."""
        super().error(printable_lines(message))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status; known errors are printed in one line."""
    if arguments is None:
        leave_out_current_folder()
    parser = Parser(
        prog="magcal", description="Calibrate a ground robot's magnetometer from one turn."
    )
    parser.add_argument("--version", action="version", version=f"magcal_ros {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for add in COMMANDS:
        add(commands)
    options = parser.parse_args(arguments)
    for stream in (sys.stdout, sys.stderr):
        # A path may contain any bytes, and a terminal may lack "µ"; neither must end a command.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        return int(_run(options))
    except BrokenPipeError:
        # The reader, for example `head`, has closed the pipe; the rest of the buffer is discarded.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return int(Exit.PIPE_CLOSED)


def _run(options: argparse.Namespace) -> Exit:
    """Run a command and flush the output, so that a closed pipe is detected; catch errors."""
    try:
        status = Exit(options.run(options))
        sys.stdout.flush()
    except KeyboardInterrupt:
        return Exit.INTERRUPTED
    except UsageError as error:
        return _print_error(error, Exit.USAGE)
    except FileError as error:
        return _print_error(error, Exit.FILE_TROUBLE)
    except Refusal as error:
        return _print_error(error, Exit.TOO_LITTLE_DATA)
    except MagcalError as error:
        return _print_error(error, Exit.FAILED)
    except BrokenPipeError:
        raise
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT) and error.filename is None:
            return _print_error(f"cannot print the result: {error.strerror}", Exit.FILE_TROUBLE)
        if error.filename is None:
            return _fault()
        # The system cannot use the user's path: too long, not permitted, missing.
        name = printable(os.fsdecode(error.filename))
        return _print_error(f"cannot use {name}: {error.strerror or error}", Exit.FILE_TROUBLE)
    except Exception:  # an error of this package, reported with the traceback
        return _fault()
    return status


def _print_error(what: object, status: Exit) -> Exit:
    tell(f"magcal: {' '.join(str(what).split())}", sys.stderr)
    return status


def _fault() -> Exit:
    traceback.print_exc()
    print(
        f"magcal: this is an error in magcal_ros {__version__}, not in your input. Please report "
        f"it with the lines above{_maintainer()}",
        file=sys.stderr,
    )
    return Exit.FAULT


def _maintainer() -> str:
    try:
        address = metadata("magcal_ros")["Maintainer-email"]
    except PackageNotFoundError:
        address = None
    return f" to {address}" if address else " to the maintainer in the package.xml"


if __name__ == "__main__":
    sys.exit(main())
