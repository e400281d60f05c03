"""A lock for two threads that neither can keep from the other."""

from __future__ import annotations

from threading import Lock


class FairLock:
    """A lock that two threads have by turns whenever both want it.

    With a plain one, who releases it and wants it again at once usually gets it again, and under a
    flood of messages a service would never be answered.
    """

    def __init__(self) -> None:
        self._held, self._next = Lock(), Lock()

    def __enter__(self) -> None:
        with self._next:
            self._held.acquire()

    def __exit__(self, *_: object) -> None:
        self._held.release()
