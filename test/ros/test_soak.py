"""A short part of `benchmarks/soak.py`."""

import subprocess
import sys
from pathlib import Path

import pytest
from long_form import rounds

SOAK = Path(__file__).resolve().parents[2] / "benchmarks" / "soak.py"

pytestmark = pytest.mark.faults


@pytest.mark.nightly
def test_messages_at_full_speed_do_not_increase_memory(ros_home):
    hours = str(rounds(0.01, 1.0))
    done = subprocess.run(
        [sys.executable, str(SOAK), "--hours", hours], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
