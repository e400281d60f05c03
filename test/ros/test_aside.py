"""The process beside the node: its answers, its faults, and its end."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from support import PATIENCE, wait_until

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.ros.aside import Aside


@pytest.fixture
def aside():
    process = Aside()
    yield process
    process.stop()


def sleep_for_long(begun):
    begun.touch()
    time.sleep(600.0)


def fail():
    raise Refusal(Reason.NO_MOTION, "it stood still")


def is_gone(pid, patience=PATIENCE):
    deadline = time.monotonic() + patience
    while time.monotonic() < deadline:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except FileNotFoundError:
            return True
        if state == "Z":
            return True
        time.sleep(0.02)
    return False


def test_it_answers_from_another_process_and_stays(aside):
    first = aside.run(os.getpid)
    assert first != os.getpid()
    assert aside.run(os.getpid) == first
    assert aside.run(divmod, 17, 5) == (3, 2)


def test_a_fault_comes_back_as_it_was_raised(aside):
    with pytest.raises(Refusal, match="it stood still") as caught:
        aside.run(fail)
    assert caught.value.reason is Reason.NO_MOTION
    assert aside.run(divmod, 17, 5) == (3, 2)


def test_ended_for_good_it_is_not_started_again(aside):
    pid = aside.run(os.getpid)
    aside.end()
    assert is_gone(pid)
    with pytest.raises(EOFError):
        aside.run(os.getpid)


def test_stopping_ends_a_call_at_once_and_the_next_starts_anew(aside, tmp_path):
    pid = aside.run(os.getpid)
    ends = []

    def wait():
        with pytest.raises((EOFError, OSError)):
            aside.run(sleep_for_long, tmp_path / "begun")
        ends.append(True)

    thread = threading.Thread(target=wait)
    thread.start()
    wait_until((tmp_path / "begun").exists)
    aside.stop()
    thread.join(PATIENCE)
    assert ends
    assert is_gone(pid)
    assert aside.run(os.getpid) != pid


def test_a_process_that_dies_is_replaced(aside):
    pid = aside.run(os.getpid)
    os.kill(pid, signal.SIGKILL)
    assert is_gone(pid)
    assert aside.run(os.getpid) != pid


ORPHAN = """
import os, signal
from magcal_ros.ros.aside import Aside
if __name__ == "__main__":
    print(Aside().run(os.getpid), flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_it_does_not_outlive_a_node_that_is_killed(tmp_path):
    script = tmp_path / "orphan.py"
    script.write_text(ORPHAN)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL
    assert is_gone(int(done.stdout))


def test_ctrl_c_in_the_terminal_does_not_reach_it(aside):
    pid = aside.run(os.getpid)
    os.kill(pid, signal.SIGINT)
    assert aside.run(os.getpid) == pid
