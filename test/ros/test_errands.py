"""Work off the executor's thread goes on whatever becomes of the executor."""

import threading
from types import SimpleNamespace

import pytest
from rclpy.executors import SingleThreadedExecutor
from support import wait_until

from magcal_ros.ros.errands import Errands


def test_an_executor_that_is_shut_down_ends_no_work(graph):
    executor = SingleThreadedExecutor()
    executor.shutdown()
    errands, found = Errands(SimpleNamespace(executor=executor), "errands"), []
    for number in range(2):
        errands.run(lambda number=number: number, found.append, found.append)
        assert errands.finish_within(5.0)
        errands.deliver()
    assert found == [0, 1]


def test_without_room_for_a_thread_who_asked_is_told_and_the_next_one_is_served(monkeypatch):
    def fail(_):
        raise RuntimeError("can't start new thread")

    errands, found, failed = Errands(SimpleNamespace(executor=None), "errands"), [], []
    with monkeypatch.context() as patched:
        patched.setattr(threading.Thread, "start", fail)
        errands.run(lambda: 1, found.append, failed.append)
    errands.deliver()
    assert "new thread" in str(failed)
    errands.run(lambda: 2, found.append, failed.append)
    assert errands.finish_within(5.0)
    errands.deliver()
    assert (found, len(failed)) == ([2], 1)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_thread_that_has_ended_is_replaced():
    errands, found = Errands(SimpleNamespace(executor=None), "errands"), []
    hand_over = errands._hand_over

    def fail(_):
        raise SystemExit

    errands._hand_over = fail
    errands.run(lambda: 1, found.append, found.append)
    errands._thread.join(5.0)
    errands._hand_over = hand_over
    errands.run(lambda: 2, found.append, found.append)
    wait_until(lambda: errands.deliver() or found)
    assert found == [2]
