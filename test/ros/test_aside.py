"""The process beside the node: its answers, its faults, and its end."""

import errno
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from support import PATIENCE

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import centred
from magcal_ros.ros.aside import Aside, Lost, Stopped


@pytest.fixture
def aside():
    process = Aside()
    yield process
    process.stop()


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
    with pytest.raises(Refusal) as caught:
        aside.run(centred, np.full((9, 3), np.nan), 3, "circle")
    assert caught.value.reason is Reason.NOT_FINITE
    assert aside.run(divmod, 17, 5) == (3, 2)


def test_ended_for_good_it_is_not_started_again(aside):
    pid = aside.run(os.getpid)
    aside.end()
    assert is_gone(pid)
    with pytest.raises(Stopped):
        aside.run(os.getpid)


def test_stopping_ends_a_call_at_once_and_the_next_starts_anew(aside):
    pid = aside.run(os.getpid)
    ends = []

    def wait():
        with pytest.raises(Stopped):
            aside.run(time.sleep, 600.0)
        ends.append(True)

    thread = threading.Thread(target=wait)
    thread.start()
    time.sleep(0.1)
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


@pytest.mark.parametrize(
    ("how", "words"),
    [
        (signal.SIGKILL, "killed (SIGKILL)"),
        (signal.SIGSTOP, "stopped (SIGSTOP)"),
        (signal.SIGTERM, "SIGTERM"),
    ],
)
def test_what_happens_to_it_in_a_call_is_said_in_words(aside, how, words):
    pid = aside.run(os.getpid)
    with pytest.raises(Lost) as caught:
        aside.run(os.kill, pid, how)
    assert words in str(caught.value)
    assert is_gone(pid)
    assert aside.run(os.getpid) != pid


def test_a_stopped_process_is_noticed_while_it_is_given_its_work(aside):
    pid = aside.run(os.getpid)
    os.kill(pid, signal.SIGSTOP)
    with pytest.raises(Lost, match="SIGSTOP"):
        aside.run(len, bytes(10**6))


def test_without_room_for_a_process_the_caller_is_told_why(aside, monkeypatch):
    def fail(*_, **__):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    with monkeypatch.context() as patched:
        patched.setattr(subprocess, "Popen", fail)
        with pytest.raises(Lost, match="cannot be started: Too many open files"):
            aside.run(os.getpid)
        aside.stop()
    assert aside.run(os.getpid)


def test_what_a_call_prints_is_no_answer(aside):
    assert aside.run(os.system, "echo not an answer >&1") == 0
    assert aside.run(divmod, 17, 5) == (3, 2)


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
