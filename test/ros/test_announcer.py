"""The log reports what is new, at a limited rate."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from rclpy.logging import get_logger

from magcal_ros.ros.announcer import LASTING, PAUSE, Announcer


class Log:
    def __init__(self):
        self.lines = []

    def info(self, message):
        self.lines.append(("info", message))

    def warning(self, message):
        self.lines.append(("warning", message))


class Stage:
    def __init__(self):
        self.log, self.now = Log(), 100.0
        node = SimpleNamespace(get_logger=lambda: self.log)
        self.announcer = Announcer(node, lambda: self.now)

    def complain_for(self, seconds, *complaints):
        for _ in range(round(seconds)):
            self.announcer.complain([text.format(self.now) for text in complaints])
            self.now += 1.0

    def take(self):
        lines, self.log.lines = self.log.lines, []
        return lines


@pytest.fixture
def stage():
    return Stage()


def test_a_fault_with_changing_numbers_is_logged_once(stage):
    stage.complain_for(3600, "/imu/mag has been silent for {:.0f} s")
    ((level, words),) = stage.take()
    assert level == "warning"
    assert words == f"/imu/mag has been silent for {100 + LASTING:.0f} s"


def test_a_short_fault_at_the_start_is_not_logged(stage):
    stage.complain_for(2, "nothing has arrived on /imu/mag")
    stage.complain_for(60)
    assert stage.take() == []


def test_another_and_a_returning_fault_are_logged(stage):
    stage.complain_for(20, "a is silent")
    stage.complain_for(20, "a is silent", "b is in microtesla")
    stage.complain_for(20, "b is in microtesla")
    stage.complain_for(20, "a is silent")
    assert [words for _, words in stage.take()] == [
        "a is silent", "b is in microtesla", "a is silent",
    ]  # fmt: skip


def test_an_intermittent_fault_is_logged_every_ten_seconds_at_most(stage):
    for _ in range(100):
        stage.complain_for(LASTING + 1, "a is silent")
        stage.complain_for(1)
    seconds = 100 * (LASTING + 2)
    assert 1 < len(stage.take()) <= seconds / PAUSE + 1


def test_thousands_of_changes_give_one_line_in_ten_seconds(stage):
    for k in range(120_000):
        stage.now += 1e-4
        stage.announcer.tell("reference", f"place {k}")
    lines = stage.take()
    assert lines[0] == ("info", "place 0")
    assert len(lines) == 2
    stage.now += PAUSE
    stage.announcer.complain([])
    stage.announcer.complain([])
    assert stage.take() == [("info", "place 119999")]


def test_subjects_are_independent_and_nothing_is_repeated(stage):
    for _ in range(50):
        stage.now += PAUSE
        stage.announcer.tell("a", "one")
        stage.announcer.tell("b", "two", wrong=True)
    assert stage.take() == [("info", "one"), ("warning", "two")]


def test_the_memory_for_complaints_is_bounded(stage):
    for k in range(10_000):
        stage.complain_for(LASTING + 2, f"{chr(0x4E00 + k)} is wrong")
    assert len(stage.announcer._wrong_since) <= 1
    assert len(stage.announcer._complained_at) <= PAUSE


def test_rclpys_own_logger_takes_every_announcement_in_any_order(capfd):
    now = [100.0]
    node = SimpleNamespace(get_logger=lambda: get_logger("announcer"))
    announcer = Announcer(node, lambda: now[0], lasting=0.0)
    for number in range(3):
        for subject, wrong in (("a", False), ("b", True), ("c", False), ("d", True)):
            announcer.tell(subject, f"{subject} {number}", wrong=wrong)
            announcer.tell(subject, f"{subject} {number} again", wrong=not wrong)
        announcer.complain([f"{chr(ord('e') + number)} is wrong"])
        now[0] += PAUSE
        announcer.complain([])
        now[0] += PAUSE
    printed = capfd.readouterr()
    for words in ("a 0", "a 0 again", "d 2", "d 2 again", "g is wrong"):
        assert f"[announcer]: {words}" in printed.err
