"""Work in the background thread does not depend on the executor."""

import threading
from types import SimpleNamespace

import pytest
from rclpy.executors import SingleThreadedExecutor
from support import wait_until

from magcal_ros.ros.threads import BackgroundThread


def test_shutting_down_the_executor_ends_no_work(graph):
    executor = SingleThreadedExecutor()
    executor.shutdown()
    thread, found = BackgroundThread(SimpleNamespace(executor=executor), "thread"), []
    for number in range(2):
        thread.run(lambda number=number: number, found.append, found.append)
        assert thread.finish_within(5.0)
        thread.deliver()
    assert found == [0, 1]


def test_a_failed_start_of_a_thread_is_reported_and_the_next_job_runs(monkeypatch):
    def fail(_):
        raise RuntimeError("can't start new thread")

    thread, found, failed = BackgroundThread(SimpleNamespace(executor=None), "thread"), [], []
    with monkeypatch.context() as patched:
        patched.setattr(threading.Thread, "start", fail)
        thread.run(lambda: 1, found.append, failed.append)
    thread.deliver()
    assert "new thread" in str(failed)
    thread.run(lambda: 2, found.append, failed.append)
    assert thread.finish_within(5.0)
    thread.deliver()
    assert (found, len(failed)) == ([2], 1)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_thread_that_has_ended_is_replaced():
    thread, found = BackgroundThread(SimpleNamespace(executor=None), "thread"), []
    hand_over = thread._hand_over

    def fail(_):
        raise SystemExit

    thread._hand_over = fail
    thread.run(lambda: 1, found.append, found.append)
    thread._thread.join(5.0)
    thread._hand_over = hand_over
    thread.run(lambda: 2, found.append, found.append)
    wait_until(lambda: thread.deliver() or found)
    assert found == [2]
