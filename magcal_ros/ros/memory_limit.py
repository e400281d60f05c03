"""A bound on the node's memory, so that no request can take the machine's.

The middleware makes room for as many values as a request claims to hold, before rclpy or the node
sees it, and Python waits for as long. Where the room is refused, the request ends as an error of
one callback and the node goes on.
"""

from __future__ import annotations

import sys
from pathlib import Path


def bound(megabytes: float) -> None:
    """Let this process take so much more memory than it has now.

    Only Linux counts what a process takes in this way; elsewhere nothing is bound.
    """
    if sys.platform == "linux":
        _limit(_data_bytes() + int(megabytes * 1e6))


def unbound() -> None:
    """Take the bound away again, in a process that was started by a bounded one."""
    if sys.platform == "linux":
        _limit(None)


def _limit(soft: int | None) -> None:
    import resource

    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    if soft is None or (hard != resource.RLIM_INFINITY and soft > hard):
        soft = hard
    resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _data_bytes() -> int:
    """Return the data memory of this process, as proc(5) counts it in `statm`."""
    import resource

    return int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
