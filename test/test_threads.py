"""Commands compute in one thread unless told otherwise."""

import os
import subprocess
import sys

import pytest

SCRIPT = "import magcal_ros.cli.main, os; print(os.environ['{pool}'])"


@pytest.mark.parametrize(
    ("pool", "given"), [("OMP_NUM_THREADS", None), ("OPENBLAS_NUM_THREADS", "3")]
)
def test_the_command_takes_one_thread_unless_the_user_says_otherwise(pool, given):
    environment = {name: value for name, value in os.environ.items() if name != pool}
    if given is not None:
        environment[pool] = given
    answer = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(pool=pool)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert answer.stdout.strip() == (given or "1")
