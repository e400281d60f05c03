"""The lock shared by the executor and the loop of the sensors."""

import threading
import time

from magcal_ros.ros.threads import FairLock


def test_a_thread_that_releases_and_requests_it_lets_the_other_in_between():
    lock, is_over, held, overtaken = FairLock(), threading.Event(), [], []

    def hold_nearly_always():
        while not is_over.is_set():
            with lock:
                held.append("often")
                time.sleep(0.002)

    thread = threading.Thread(target=hold_nearly_always)
    thread.start()
    try:
        for _ in range(20):
            time.sleep(0.003)
            before = len(held)
            with lock:
                overtaken.append(len(held) - before)
    finally:
        is_over.set()
        thread.join()
    # The turn that was under way, and at most one that had begun to wait before us; a busy machine
    # may now and then stop us before we begin to wait.
    assert sorted(overtaken)[len(overtaken) // 2] <= 2


def test_only_one_thread_has_the_lock():
    lock, inside, most = FairLock(), [0], [0]

    def work():
        for _ in range(300):
            with lock:
                inside[0] += 1
                most[0] = max(most[0], inside[0])
                time.sleep(0.0)
                inside[0] -= 1

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == [1]
