"""Being told to end: by a person, by a supervisor, by the terminal that goes away.

rclpy's own handlers take the context down first, and then nothing can be published any more: a
robot that turns would turn on. Here the process is left as it is and somebody is told, in a
thread of its own, so that a callback that does not return cannot stand in the way.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable

SIGNALS = (
    signal.SIGINT,
    signal.SIGTERM,
    signal.SIGHUP,
    signal.SIGQUIT,
    signal.SIGABRT,
    signal.SIGUSR1,
    signal.SIGUSR2,
    signal.SIGALRM,
    signal.SIGVTALRM,
    signal.SIGPROF,
    signal.SIGXCPU,
)
"""Every one that would end the process and can be caught: a robot that turns must be stopped."""


class EndSignals:
    """Notes that the process was told to end.

    To be made in the main thread, before the middleware starts threads.
    """

    def __init__(self) -> None:
        self._told = threading.Event()
        self._listener: Callable[[], None] | None = None
        self._lock = threading.Lock()
        self._reader, writer = os.pipe()
        os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        for number in SIGNALS:
            # nohup means: stay when the terminal goes.
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, lambda *_: None)
        threading.Thread(target=self._watch, name="magcal-signals", daemon=True).start()

    def when_given(self, listener: Callable[[], None]) -> None:
        """Call back once, from another thread; at once if the process was told already."""
        with self._lock:
            self._listener = listener
            if not self._told.is_set():
                return
        listener()

    def _watch(self) -> None:
        os.read(self._reader, 1)
        with self._lock:
            self._told.set()
            listener = self._listener
        if listener is not None:
            listener()
