"""How this package's programs run: one thread of linear algebra, no code from the current folder.

Python looks for modules in the current folder where a program is started by `-m` or `-c`, and
where PYTHONPATH has an empty entry. A robot's node may be started anywhere, also in a folder in
which somebody keeps a `select.py` of their own, so the processes of this package do without.

The package's commands begin here, so this module imports only what Python itself has loaded
before it: anything else could still come from the current folder.
"""

import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    import subprocess
    from collections.abc import Mapping
    from typing import Any

POOLS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

START = """
import sys
sys.path[:] = [sys.argv[1], *filter(None, sys.path)]
import magcal_ros
del sys.path[0]
from importlib import import_module
del sys.argv[:2]
sys.exit(import_module(sys.argv[0]).main())
"""
"""Runs `main` of a module of this very package, wherever another one is installed as well."""


def use_one_thread() -> None:
    """Let numpy compute in one thread, unless the user has said otherwise.

    The matrices here are small: threads would hold each other up, and take the cores from others.
    It holds for a numpy that is loaded later, and for processes started from this one.
    """
    for pool in POOLS:
        os.environ.setdefault(pool, "1")


def calibrator() -> int:
    """Run the executable `calibrator`; returns the exit status."""
    return _run("magcal_ros.ros.main")


def magcal() -> int:
    """Run the command `magcal`; returns the exit status."""
    return _run("magcal_ros.cli.main")


def _run(module: str) -> int:
    leave_out_current_folder()
    from importlib import import_module

    return int(import_module(module).main())


def start(
    module: str,
    *arguments: str,
    extra: "Mapping[str, str] | None" = None,
    **options: "Any",
) -> "subprocess.Popen[bytes]":
    """Start `main` of a module in a process of its own.

    The arguments come to its `sys.argv`, `extra` to its environment; options are those of
    `subprocess.Popen`. An OSError if the system has no room for another process.
    """
    import subprocess

    root = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
    environment = {**os.environ, **(extra or {})}
    given = environment.pop("PYTHONPATH", "").split(os.pathsep)
    if absolute := [entry for entry in given if os.path.isabs(entry)]:
        environment["PYTHONPATH"] = os.pathsep.join(absolute)
    command = [sys.executable, "-c", START, root, module, *arguments]
    return subprocess.Popen(command, env=environment, **options)


def leave_out_current_folder() -> None:
    """Let this process import nothing more from the current folder, unless it is named in full."""
    try:
        here = os.getcwd()
    except FileNotFoundError:
        return
    given = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    relative = {os.path.normpath(os.path.join(here, e)) for e in given if not os.path.isabs(e)}
    if sys.path and sys.path[0] in ("", here):
        del sys.path[0]
    if os.environ.get("PYTHONPATH"):
        sys.path[:] = [entry for entry in sys.path if entry in given or entry not in relative]


def bound_memory(megabytes: float) -> None:
    """Let this process take so much more memory (RLIMIT_DATA) than it has now.

    The middleware makes room for as many values as a request claims to hold, before rclpy or the
    node sees it. Where the room is refused, the request ends as an error of one callback. Only
    Linux counts what a process takes in this way; elsewhere nothing is bound.
    """
    if sys.platform != "linux":
        return
    import resource

    with open("/proc/self/statm", encoding="ascii") as statm:
        # The sixth number of proc(5) is the data memory, in pages.
        taken = int(statm.read().split()[5]) * resource.getpagesize()
    soft, hard = taken + int(megabytes * 1e6), resource.getrlimit(resource.RLIMIT_DATA)[1]
    if hard != resource.RLIM_INFINITY:
        soft = min(soft, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def unbound_memory() -> None:
    """Take the bound away again, in a process that was started by a bounded one."""
    if sys.platform == "linux":
        import resource

        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        resource.setrlimit(resource.RLIMIT_DATA, (hard, hard))
