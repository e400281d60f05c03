"""The executable `ros2 run magcal_ros calibrator`.

Signals that end the process come from the user, a supervisor or a closed terminal. rclpy's signal
handlers shut down the context first; then no zeros can be published to stop a robot that turns.
Here a separate thread waits for signals, so that a blocked callback cannot delay it.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Sequence

import rclpy
from rclpy.signals import SignalHandlerOptions

from magcal_ros.processes import bound_memory, leave_out_current_folder, use_one_thread
from magcal_ros.ros.guard import SIGNALS
from magcal_ros.ros.node import Calibrator


def catch_end_signals() -> int:
    """Return a file descriptor from which the signals that end the process can be read.

    To be called before the middleware starts threads.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    for number in SIGNALS:
        # Under nohup the process continues when the terminal is closed.
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda *_: None)
    return reader


SWITCH_INTERVAL = 0.0005
"""Python's switch interval between threads, seconds. With the default of 5 ms, background work
would delay messages by as much."""

LAST_RESORT = 8.0
"""Seconds after which the process exits even if it is blocked, for example by a lock of the
middleware that a dead process holds. `ros2 launch` kills after 10."""

ENDING = 1.0
"""Seconds that a callback of the sensors may take to return while the node shuts down."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until a signal ends it; returns the exit status."""
    # The limit also holds for the worker processes that this process starts.
    use_one_thread()
    signals = catch_end_signals()
    if arguments is None:
        leave_out_current_folder()
    given = list(sys.argv if arguments is None else arguments)
    try:
        rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
    # rclpy has several base classes of errors: a bad argument or parameter file.
    except Exception as error:
        print(f"calibrator: {' '.join(str(error).split())}", file=sys.stderr)  # noqa: T201
        return 2
    sys.setswitchinterval(SWITCH_INTERVAL)
    node = None
    try:
        node = Calibrator()
        bound_memory(node.get_parameter("memory_limit_mb").value)
        _spin(node, signals)
    except Exception:
        # If the context was shut down during a callback, the error is no fault.
        if rclpy.ok():
            raise
    finally:
        if node is not None:
            node.close()
        rclpy.try_shutdown()
    return 0


def _spin(node: Calibrator, signals: int) -> None:
    spinner = node.spinner()

    def end_by_signal() -> None:
        # In a thread of its own, so that the robot stops even if a callback is blocked.
        os.read(signals, 1)
        last_resort = threading.Timer(LAST_RESORT, os._exit, [0])
        last_resort.daemon = True
        last_resort.start()
        try:
            spinner.end()
        finally:
            node.rotator.halt()

    threading.Thread(target=end_by_signal, name="magcal-signals", daemon=True).start()
    try:
        spinner.spin()
    finally:
        spinner.shutdown(timeout_sec=ENDING)


if __name__ == "__main__":
    sys.exit(main())
