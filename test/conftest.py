"""Fixtures of all tests: DDS that stays on this machine, in a separate domain per process."""

import contextlib
import fcntl
import gc
import os
import re
import sys
import tempfile
from pathlib import Path

import pytest

# As `make test` has it: threads of the linear algebra add the same numbers in another order.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Shared modules are next to the tests; pytest before 7 has no setting for it.
HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "core"), str(HERE), str(HERE.parent / "cases")]

DOMAINS = 100
"""Their ports lie below those that the system gives away."""

try:
    from hypothesis import HealthCheck, settings
except ImportError:
    # RHEL has no package of it: tests of random cases are left out there.
    collect_ignore = [
        str(path)
        for path in HERE.rglob("test_*.py")
        if re.search(r"^(from|import) (hypothesis|examples)\b", path.read_text(), re.MULTILINE)
    ]
else:
    # Speed is measured in benchmarks/; a busy machine must not fail a test. `make test` tries the
    # same cases each time, `make nightly` new ones.
    for profile, count in {"project": 30, "nightly": 300}.items():
        settings.register_profile(
            profile,
            deadline=None,
            derandomize=profile == "project",
            max_examples=count,
            suppress_health_check=[HealthCheck.too_slow],
        )
    settings.load_profile("project")

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
if os.environ.get("ROS_DISTRO") == "humble":
    os.environ["ROS_LOCALHOST_ONLY"] = "1"


def claim_domain():
    """Take a DDS domain that no other process of tests on this machine has, until this one ends."""
    for k in range(DOMAINS):
        number = 1 + (os.getpid() + k) % DOMAINS
        path = Path(tempfile.gettempdir(), f"magcal_ros_domain_{number}.lock")
        with contextlib.suppress(OSError):
            fcntl.flock(os.open(path, os.O_RDWR | os.O_CREAT), fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.environ["ROS_DOMAIN_ID"] = str(number)
            return
    raise RuntimeError("all DDS domains of this machine are taken by other tests")


claim_domain()


def pytest_collection_finish():
    """Keep all modules and tests from what is searched for garbage each time."""
    gc.freeze()


RECORDINGS = Path(__file__).resolve().parents[2] / "shared" / "recordings"


@pytest.fixture
def recording():
    """Return the folder of a shared recording, or skip where the recordings are absent."""

    def find(name):
        folder = RECORDINGS / name
        if not folder.is_dir():
            pytest.skip(f"the recording {name} is not beside this checkout (../shared/recordings)")
        return folder

    return find
