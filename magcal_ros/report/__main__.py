"""Draws one report: folder and subject come pickled on stdin, from the node that made the turn."""

from __future__ import annotations

import pickle
import signal
import sys

from magcal_ros.core.errors import MagcalError
from magcal_ros.report.write import write_report


def main() -> int:
    """Write the report; returns the exit status."""
    # Whoever ends the node means the node; a report is quick to finish.
    for ending in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ending, signal.SIG_IGN)
    folder, subject = pickle.load(sys.stdin.buffer)
    try:
        write_report(folder, subject)
    except MagcalError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
