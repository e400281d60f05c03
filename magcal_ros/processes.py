"""Start of this package's programs, with one thread of linear algebra and a safe import path.

Python imports modules from the current folder if a program is started by `-m` or `-c`, or if
PYTHONPATH has an empty entry. The node may be started in a folder with an unrelated `select.py`, so
this package removes the current folder from the import path.

The package's commands start in this module. It imports only modules that Python has loaded already,
because others might still be imported from the current folder.
"""

import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    import subprocess
    from collections.abc import Mapping
    from typing import Any

THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

START_CODE = """
import sys
sys.path[:] = [sys.argv[1], *filter(None, sys.path)]
import magcal_ros
del sys.path[0]
from importlib import import_module
del sys.argv[:2]
sys.exit(import_module(sys.argv[0]).main())
"""
"""Runs `main` of a module of this package, even if another version is installed."""


def use_one_thread() -> None:
    """Limit numpy to one thread, unless the user has set a number of threads.

    The matrices are small, so more threads would only cost time and occupy cores. The limit holds
    for a numpy that is imported later, and for child processes.
    """
    for pool in THREAD_LIMITS:
        os.environ.setdefault(pool, "1")


def calibrator() -> int:
    """Run the executable `calibrator`; returns the exit status."""
    return _run("magcal_ros.ros.main", interrupted=0)


def magcal() -> int:
    """Run the command `magcal`; returns the exit status."""
    return _run("magcal_ros.cli.main", interrupted=130)


def _run(module: str, interrupted: int) -> int:
    """Run `main` of a module; returns `interrupted` if a signal comes while it is imported."""
    leave_out_current_folder()
    import signal
    from importlib import import_module

    # The imports take a second or two. A program that wants SIGTERM sets its own handler.
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        main = import_module(module).main
        signal.signal(signal.SIGTERM, before)
    except KeyboardInterrupt:
        return interrupted
    return int(main())


def start(
    module: str,
    *arguments: str,
    extra: "Mapping[str, str] | None" = None,
    **options: "Any",
) -> "subprocess.Popen[bytes]":
    """Start `main` of a module in a new process.

    The arguments are added to `sys.argv`, `extra` to the environment; options are those of
    `subprocess.Popen`. Raises OSError if the system cannot start another process.
    """
    import subprocess

    root = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
    environment = {**os.environ, **(extra or {})}
    given = environment.pop("PYTHONPATH", "").split(os.pathsep)
    if absolute := [entry for entry in given if os.path.isabs(entry)]:
        environment["PYTHONPATH"] = os.pathsep.join(absolute)
    command = [sys.executable, "-c", START_CODE, root, module, *arguments]
    return subprocess.Popen(command, env=environment, **options)


def leave_out_current_folder() -> None:
    """Remove the current folder from the import path, unless PYTHONPATH has its full path."""
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
    """Limit the memory of this process (RLIMIT_DATA) to `megabytes` more than it uses now.

    The middleware allocates memory for as many values as a request claims to contain. With the
    limit, a malformed request causes an error of one callback only. The limit is set on Linux only,
    because other systems count the memory differently.
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
    """Remove the limit that a child process inherits from a process with `bound_memory`."""
    if sys.platform == "linux":
        import resource

        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        resource.setrlimit(resource.RLIMIT_DATA, (hard, hard))
