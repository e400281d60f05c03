"""The guard of a robot that turns itself, with real processes that are killed or stopped."""

import os
import signal
import subprocess
import sys
import time
from uuid import uuid4

import pytest
import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from support import PATIENCE, wait_until

from magcal_ros.ros import guard as guard_module
from magcal_ros.ros.guard import Guard, is_needed

SILENCE = 1.0
"""Seconds: a busy machine may keep a process from its word for longer than a robot should wait."""

NODE = """
import sys, time
from magcal_ros.ros import guard
guard.SILENCE = float(sys.argv[2])
guard = guard.Guard(sys.argv[1], False, "")
while not guard.is_ready:
    time.sleep(0.01)
print("ready", flush=True)
while True:
    guard.tell_alive()
    time.sleep(0.05)
"""


@pytest.fixture(autouse=True)
def silence(monkeypatch):
    monkeypatch.setattr(guard_module, "SILENCE", SILENCE)


@pytest.fixture
def topic():
    """Return a separate topic: the guard of the previous test may still publish."""
    return f"/cmd_vel_{uuid4().hex}"


@pytest.fixture
def base(graph, topic):
    """Return the received commands, and a function that listens for a while."""
    node = rclpy.create_node("base")
    received = []
    node.create_subscription(Twist, topic, lambda m: received.append(m.angular.z), 50)

    def listen(seconds, until=lambda: False):
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not until():
            rclpy.spin_once(node, timeout_sec=0.02)
        return received

    yield listen
    node.destroy_node()


@pytest.fixture
def doomed(topic):
    """Return a process that keeps a guard inactive until it ends."""
    command = [sys.executable, "-c", NODE, topic, str(SILENCE)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    yield process
    process.kill()
    process.wait()


@pytest.mark.parametrize(
    "number",
    [signal.SIGKILL, signal.SIGSTOP, pytest.param(signal.SIGSEGV, marks=pytest.mark.nightly)],
)
def test_zeros_follow_a_signal_that_cannot_be_caught(base, doomed, number):
    assert base(0.5) == []
    os.kill(doomed.pid, number)
    received = base(PATIENCE, lambda: len(base(0.0)) >= 5)
    assert received[:5] == [0.0] * 5


def test_a_dismissed_guard_ends_without_a_command(base, topic):
    guard = Guard(topic, False, "")
    base(PATIENCE, lambda: guard.is_ready)
    assert guard.is_ready
    for _ in range(5):
        guard.tell_alive()
        base(0.1)
    guard.dismiss()
    assert base(SILENCE + 0.5) == []
    base(PATIENCE, lambda: guard.has_ended)
    assert guard.has_ended


def test_a_guard_ends_after_it_has_stopped_the_base(base, topic):
    guard = Guard(topic, False, "")
    base(PATIENCE, lambda: guard.is_ready)
    assert not guard.has_ended
    guard.tell_alive()
    base(PATIENCE, lambda: guard.has_ended)
    assert guard.has_ended
    assert not guard.is_ready
    assert set(base(1.5)) == {0.0}
    guard.tell_alive()
    guard.dismiss()


def test_zeros_are_stamped_if_the_base_needs_it(graph, topic):
    node, received = rclpy.create_node("base"), []
    node.create_subscription(TwistStamped, topic, received.append, 50)
    guard, reported = Guard(topic, True, "chassis"), False
    deadline = time.monotonic() + PATIENCE
    while not received and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.02)
        if guard.is_ready and not reported:
            reported = True
            guard.tell_alive()
    assert received[0].header.frame_id == "chassis"
    assert received[0].twist.angular.z == 0.0
    guard.dismiss()
    node.destroy_node()


@pytest.mark.parametrize(
    ("words", "needed"),
    [(b"", False), (b"q\n", False), (b"?a\n", False), (b".a\n", True), (b".a\n.b\nq\n", False)],
)
def test_the_guard_acts_only_if_the_node_ends_while_the_robot_may_move(words, needed):
    line, node = os.pipe()
    os.write(node, words)
    os.close(node)
    assert is_needed(line, guard_module.SILENCE, lambda _: None) is needed
    os.close(line)


def test_questions_alone_do_not_prevent_the_guard_from_stopping_the_robot():
    line, node = os.pipe()
    os.write(node, b".a\n")
    assert is_needed(line, 0.05, lambda _: os.write(node, b"?b\n"))
    os.close(node)
    os.close(line)


def test_a_stopped_guard_is_not_ready_and_is_removed(base, topic):
    guard = Guard(topic, False, "")
    base(PATIENCE, lambda: guard.is_ready)
    assert guard.is_ready
    process = guard._process
    process.send_signal(signal.SIGSTOP)
    began = time.monotonic()
    base(PATIENCE, lambda: not guard.is_ready)
    assert time.monotonic() - began < SILENCE + 0.5
    assert not guard.has_ended
    guard.dismiss()
    wait_until(lambda: process.poll() is not None)


IMPOSTOR = """
import sys
for line in sys.stdin.buffer:
    {says}
    sys.stdout.buffer.flush()
"""


@pytest.mark.parametrize(
    "says",
    [
        "sys.stdout.buffer.write(b'r')",
        "sys.stdout.buffer.write(line[1:])",
        "sys.stdout.buffer.write(line[1:-1] + b' zeros as Twist on /elsewhere after 1 s\\n')",
        "sys.stdout.buffer.write(b'0 zeros as Twist on /cmd_vel after 1 s\\n')",
    ],
)
def test_a_process_with_other_answers_is_no_guard(monkeypatch, says):
    def start(*_, extra, **options):
        return subprocess.Popen([sys.executable, "-c", IMPOSTOR.format(says=says)], **options)

    monkeypatch.setattr(guard_module, "start", start)
    guard = Guard("/cmd_vel", False, "")
    deadline = time.monotonic() + 0.5
    while time.monotonic() < deadline:
        assert not guard.is_ready
        time.sleep(0.02)
    guard.dismiss()
