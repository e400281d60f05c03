"""The worker process of the node: its answers, its errors, and its end."""

import errno
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from support import PATIENCE, wait_until

from magcal_ros.core import Reason, Refusal
from magcal_ros.core.geometry import centred
from magcal_ros.ros.worker_process import WorkerLost, WorkerProcess, WorkerStopped


@pytest.fixture
def worker():
    process = WorkerProcess()
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


def test_the_worker_answers_and_stays_alive(worker):
    first = worker.run(os.getpid)
    assert first != os.getpid()
    assert worker.run(os.getpid) == first
    assert worker.run(divmod, 17, 5) == (3, 2)


def test_an_exception_is_passed_to_the_caller(worker):
    with pytest.raises(Refusal) as caught:
        worker.run(centred, np.full((9, 3), np.nan), 3, "circle")
    assert caught.value.reason is Reason.NOT_FINITE
    assert worker.run(divmod, 17, 5) == (3, 2)


def test_an_ended_worker_is_not_started_again(worker):
    pid = worker.run(os.getpid)
    worker.end()
    assert is_gone(pid)
    with pytest.raises(WorkerStopped):
        worker.run(os.getpid)


def test_stopping_ends_a_call_immediately_and_the_next_starts_a_process(worker):
    pid = worker.run(os.getpid)
    ends = []

    def wait():
        with pytest.raises(WorkerStopped):
            worker.run(time.sleep, 600.0)
        ends.append(True)

    thread = threading.Thread(target=wait)
    thread.start()
    time.sleep(0.1)
    worker.stop()
    thread.join(PATIENCE)
    assert ends
    assert is_gone(pid)
    assert worker.run(os.getpid) != pid


def test_a_process_that_ended_is_replaced(worker):
    pid = worker.run(os.getpid)
    os.kill(pid, signal.SIGKILL)
    assert is_gone(pid)
    assert worker.run(os.getpid) != pid


@pytest.mark.parametrize(
    ("how", "words"),
    [
        (signal.SIGKILL, "killed (SIGKILL)"),
        (signal.SIGSTOP, "stopped (SIGSTOP)"),
        (signal.SIGTERM, "SIGTERM"),
    ],
)
def test_the_end_of_the_process_during_a_call_is_explained(worker, how, words):
    pid = worker.run(os.getpid)
    with pytest.raises(WorkerLost) as caught:
        worker.run(os.kill, pid, how)
    assert words in str(caught.value)
    assert is_gone(pid)
    assert worker.run(os.getpid) != pid


def test_a_stopped_process_is_detected_while_it_receives_its_job(worker):
    pid = worker.run(os.getpid)
    os.kill(pid, signal.SIGSTOP)
    with pytest.raises(WorkerLost, match="SIGSTOP"):
        worker.run(len, bytes(10**6))


def test_a_process_that_cannot_be_started_is_explained(worker, monkeypatch):
    def fail(*_, **__):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    with monkeypatch.context() as patched:
        patched.setattr(subprocess, "Popen", fail)
        with pytest.raises(WorkerLost, match="cannot be started: Too many open files"):
            worker.run(os.getpid)
        worker.stop()
    assert worker.run(os.getpid)


def test_an_existing_process_answers_without_free_file_descriptors(worker):
    pid, pipe = worker.run(os.getpid), worker.start().stdin.fileno()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (100, hard))
    taken = []

    def take_all():
        while True:
            taken.append(os.dup(pipe))

    try:
        with pytest.raises(OSError, match="Too many open files"):
            take_all()
        answer = worker.run(os.getpid)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        for number in taken:
            os.close(number)
    assert answer == pid


def test_printed_text_is_not_taken_for_an_answer(worker):
    assert worker.run(os.system, "echo not an answer >&1") == 0
    assert worker.run(divmod, 17, 5) == (3, 2)


ORPHAN = """
import os, signal
from magcal_ros.ros.worker_process import WorkerProcess
if __name__ == "__main__":
    print(WorkerProcess().run(os.getpid), flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_the_worker_ends_with_a_killed_node(tmp_path):
    script = tmp_path / "orphan.py"
    script.write_text(ORPHAN)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL
    assert is_gone(int(done.stdout))


def test_ctrl_c_in_the_terminal_does_not_end_the_worker(worker):
    pid = worker.run(os.getpid)
    os.kill(pid, signal.SIGINT)
    assert worker.run(os.getpid) == pid


def test_a_single_call_is_completed_although_the_node_ends(tmp_path):
    """The process has the whole call before it starts to read: four megabytes fill any pipe."""
    place = tmp_path / "done"
    script = (
        "import threading, time\n"
        "from pathlib import Path\n"
        "from magcal_ros.ros.worker_process import WorkerProcess\n"
        f"work = (Path.write_bytes, Path({str(place)!r}), bytes(4_000_000))\n"
        "threading.Thread(target=WorkerProcess().run_once, args=work, daemon=True).start()\n"
        "time.sleep(0.5)\n"
    )
    ended = subprocess.run([sys.executable, "-c", script], stderr=subprocess.PIPE, timeout=60.0)
    assert ended.returncode == 0
    wait_until(lambda: place.exists() and place.stat().st_size == 4_000_000)
    assert b"Error" not in ended.stderr
