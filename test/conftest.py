"""What every test shares: DDS that stays on this machine, in a domain of the process's own."""

import os
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# What tests share lies beside them; pytest before 7 has no setting for it.
HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "core"), str(HERE), str(HERE.parent / "benchmarks")]

# Speed is measured in benchmarks/; a busy machine must not fail a test. `make test` tries the same
# cases each time, `make nightly` new ones.
for profile, examples in {"project": 30, "nightly": 300}.items():
    settings.register_profile(
        profile,
        deadline=None,
        derandomize=profile == "project",
        max_examples=examples,
        suppress_health_check=[HealthCheck.too_slow],
    )
settings.load_profile("project")

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
if os.environ.get("ROS_DISTRO") == "humble":
    os.environ["ROS_LOCALHOST_ONLY"] = "1"
worker = os.environ.get("PYTEST_XDIST_WORKER")
# Workers inherit the domain of the process that starts them, and count on from it.
first = int(os.environ["ROS_DOMAIN_ID"]) + 1 + int(worker[2:]) if worker else os.getpid()
os.environ["ROS_DOMAIN_ID"] = str(1 + first % 100)

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
