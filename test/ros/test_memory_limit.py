"""The memory limit: enough for the node's work, but not for a malformed request."""

import subprocess
import sys
import time
from pathlib import Path

import pytest
from support import PATIENCE

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux counts data memory so")

TAKE = """
from magcal_ros import processes
processes.bound_memory(300)
{before}
try:
    print(len(bytearray({megabytes} * 10**6)))
except MemoryError:
    print("refused")
"""


def take(megabytes, before=""):
    """Return the output of a limited process that allocates this much."""
    code = TAKE.format(megabytes=megabytes, before=before)
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return run.stdout.strip()


def test_memory_within_the_limit_is_allocated_and_more_is_refused():
    assert take(200) == "200000000"
    assert take(400) == "refused"


def test_a_fitting_process_has_no_limit():
    assert take(400, "processes.unbound_memory()") == "400000000"


def test_a_lower_limit_of_the_system_is_kept():
    hard = "import resource; resource.setrlimit(resource.RLIMIT_DATA, (350 * 10**6,) * 2)"
    assert take(400, f"{hard}; processes.bound_memory(10**6)") == "refused"


def test_the_executable_sets_its_limit(graph):
    process = subprocess.Popen(
        [sys.executable, "-m", "magcal_ros.ros.main", "--ros-args", "-p", "memory_limit_mb:=500"],
        stderr=subprocess.DEVNULL,
    )
    try:
        assert 500e6 < soft_limit(process.pid) < 1500e6
    finally:
        process.terminate()
        process.wait()


def soft_limit(pid, patience_s=PATIENCE):
    """Return the bound on a process's data memory in bytes, once it is there."""
    deadline = time.monotonic() + patience_s
    while time.monotonic() < deadline:
        line = next(
            line
            for line in Path(f"/proc/{pid}/limits").read_text().splitlines()
            if line.startswith("Max data size")
        )
        if (soft := line.split()[3]) != "unlimited":
            return float(soft)
        time.sleep(0.1)
    raise AssertionError("the node did not bound its memory")
