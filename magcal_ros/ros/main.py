"""The executable `ros2 run magcal_ros calibrator`.

Signals that end the process come from a person, a supervisor or a closed terminal. rclpy's own
handlers take the context down first, and then nothing can be published any more: a robot that turns
would not be stopped. Here a signal calls a listener in a thread of its own, so that a callback that
does not return cannot delay it.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.signals import SignalHandlerOptions

from magcal_ros.processes import bound_memory, leave_out_current_folder, use_one_thread
from magcal_ros.ros.node import Calibrator

NAMES = ("INT", "TERM", "HUP", "QUIT", "ABRT", "USR1", "USR2", "ALRM", "VTALRM", "PROF", "XCPU")
SIGNALS = tuple(getattr(signal, f"SIG{name}") for name in NAMES)
"""Every one that would end the process and can be caught: a robot that turns must be stopped."""


class EndSignals:
    """Notes that the process was told to end; to be made before the middleware starts threads."""

    def __init__(self) -> None:
        self._reader, writer = os.pipe()
        os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        for number in SIGNALS:
            # nohup means: stay when the terminal goes.
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, lambda *_: None)

    def when_given(self, listener: Callable[[], None]) -> None:
        """Call back once, from another thread; at once if a signal has come already."""

        def watch() -> None:
            os.read(self._reader, 1)
            listener()

        threading.Thread(target=watch, name="magcal-signals", daemon=True).start()


SWITCH_INTERVAL = 0.0005
"""Seconds after which the thread that hands over a turn or stores a calibration gives way to a
message that waits. With Python's own 5 ms a message that came then would be late by as much."""

LAST_RESORT = 8.0
"""Seconds after which a process that is to end is gone, whatever it still waits for: a lock
of the middleware that another process took with it, say. `ros2 launch` kills after 10."""

ENDING = 1.0
"""Seconds that a callback of the sensors may take to return when the node is being ended."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until a signal ends it; returns the exit status."""
    # Fits and reports are computed in processes started from here.
    use_one_thread()
    signals = EndSignals()
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
    except ExternalShutdownException:
        pass
    except Exception:
        # The context may go away in the middle of a callback: that is an end, no fault.
        if rclpy.ok():
            raise
    finally:
        if node is not None:
            node.close()
        rclpy.try_shutdown()
    return 0


def _spin(node: Calibrator, signals: EndSignals) -> None:
    spinner = node.spinner()

    def end() -> None:
        # From the signals' thread, so that the robot stops even if a callback hangs.
        last_resort = threading.Timer(LAST_RESORT, os._exit, [0])
        last_resort.daemon = True
        last_resort.start()
        try:
            spinner.end()
        finally:
            node.rotator.halt()

    signals.when_given(end)
    try:
        spinner.spin()
    finally:
        spinner.shutdown(timeout_sec=ENDING)


if __name__ == "__main__":
    sys.exit(main())
