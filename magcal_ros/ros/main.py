"""The executable `ros2 run magcal_ros calibrator`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import rclpy
from rclpy.executors import ExternalShutdownException

from magcal_ros.ros.node import Calibrator

SWITCH_INTERVAL = 0.0005
"""Seconds after which the thread that hands over a turn or stores a calibration gives way to a
message that waits. With Python's own 5 ms a message that came then would be late by as much."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until it is told to stop; returns the exit status."""
    try:
        rclpy.init(args=list(sys.argv if arguments is None else arguments))
    except Exception as error:  # rclpy has several roots: a bad argument or parameter file
        print(f"calibrator: {' '.join(str(error).split())}", file=sys.stderr)  # noqa: T201
        return 2
    sys.setswitchinterval(SWITCH_INTERVAL)
    node = None
    try:
        node = Calibrator()
        node.executor_of_its_own().spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception:
        # A signal can take the context away in the middle of a callback: that is an end, no fault.
        if rclpy.ok():
            raise
    finally:
        if node is not None:
            node.close()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
