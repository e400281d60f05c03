"""The file of a new sensor is read once, in the background, whatever its frame does."""

import math
import threading

import pytest
from support import PATIENCE, REFERENCE, store_calibration

from magcal_ros.files import read_calibration
from magcal_ros.ros import calibration_store
from magcal_ros.ros.calibration_store import CalibrationStore
from magcal_ros.ros.heading_pipeline import Sensor

pytestmark = pytest.mark.faults


class Elsewhere:
    """A runner that does its work on request."""

    def __init__(self):
        self.waiting = []

    def run(self, work, then, otherwise):
        self.waiting.append((work, then, otherwise))

    def go(self):
        work, then, otherwise = self.waiting.pop(0)
        try:
            result = work()
        except Exception as error:
            otherwise(error)
        else:
            then(result)


class Lines(list):
    """The node that is called /calibrator, and its log."""

    def info(self, line):
        self.append(line)

    error = warning = info

    def get_logger(self):
        return self

    def get_namespace(self):
        return "/"

    def get_name(self):
        return "calibrator"


@pytest.fixture
def reads(monkeypatch):
    """Return the paths that are read from the disk, in their order."""
    paths = []

    def read(path):
        paths.append(path.name)
        return read_calibration(path)

    monkeypatch.setattr(calibration_store, "read_calibration", read)
    return paths


@pytest.fixture
def met(ros_home, reads):
    """Return store, its runner and log; only the file of `left` exists."""
    store_calibration(ros_home / "magcal" / "calibrator.left.yaml", frame="left")
    files, log = Elsewhere(), Lines()
    return CalibrationStore(log, files, lambda *_: None), files, log


def begun_with(chosen, files, log=None):
    """Return a store that has begun to read a chosen file."""
    log = Lines() if log is None else log
    store = CalibrationStore(log, files, lambda *_: None, lambda: str(chosen))
    store.begin()
    return store


def test_the_file_of_a_new_sensor_is_loaded_and_reported(met):
    store, files, log = met
    store.note_sensor("left")
    assert store.calibration is None
    files.go()
    assert store.origin.magnetometer_frame == "left"
    # The log must not delay the messages.
    assert not log
    files.go()
    assert "left.yaml" in log[0]


def test_alternating_frames_read_each_file_once(met, reads):
    store, files, _ = met
    for _ in range(20):
        for frame in ("right", "left", ""):
            store.note_sensor(frame)
        while files.waiting:
            files.go()
    assert reads == ["calibrator.left.yaml"]
    assert store.origin.magnetometer_frame == "left"


def test_many_frames_with_a_slow_disk_start_one_read(met, reads):
    store, files, _ = met
    for k in range(200):
        store.note_sensor(f"name_{k}")
    store.note_sensor("left")
    assert len(files.waiting) == 1
    while files.waiting:
        files.go()
    assert reads == ["calibrator.left.yaml"]
    assert store.calibration is not None


def test_a_file_read_for_an_earlier_frame_is_used_when_it_returns(met, reads):
    store, files, _ = met
    store.note_sensor("left")
    store.note_sensor("right")
    while files.waiting:
        files.go()
    assert store.calibration is None
    store.note_sensor("left")
    assert store.calibration is not None
    assert reads == ["calibrator.left.yaml"]


def test_a_reset_calibration_is_not_loaded_again(met):
    store, files, _ = met
    store.note_sensor("left")
    files.go()
    store.forget()
    store.reset()
    store.note_sensor("right")
    while files.waiting:
        files.go()
    store.note_sensor("left")
    assert store.calibration is None


def test_a_file_read_during_a_reset_is_not_used(met):
    store, files, _ = met
    store.note_sensor("left")
    store.forget()
    files.go()
    assert store.calibration is None
    store.note_sensor("")
    store.note_sensor("left")
    assert store.calibration is None


def test_a_chosen_file_is_not_loaded_after_a_reset_and_the_first_message(ros_home):
    chosen = store_calibration(ros_home / "chosen.yaml", frame="left")
    files = Elsewhere()
    store = begun_with(chosen, files)
    files.go()
    store.forget()
    store.reset()
    store.note_sensor("left")
    while files.waiting:
        files.go()
    assert store.calibration is None


def test_a_calibration_during_the_read_has_priority(met):
    store, files, _ = met
    store.note_sensor("left")
    loaded = store.read("", "left")
    store.use(loaded)
    before = store.calibration
    files.go()
    assert store.calibration is before


def test_a_file_that_has_changed_is_read_again(met, ros_home):
    store, *_ = met
    path = ros_home / "magcal" / "calibrator.left.yaml"
    store.read("", "left")
    store_calibration(path, subtracted=0.25, frame="left")
    assert store.read("", "left").calibration.evidence.figures["steady_pull"] == 0.25


def test_a_damaged_file_is_reported_until_it_is_replaced(met, ros_home):
    store, files, log = met
    (ros_home / "magcal" / "calibrator.bad.yaml").write_text("format: [")
    store.note_sensor("bad")
    files.go()
    assert "Running uncalibrated" in log[0]
    assert "bad.yaml" in store.problem


def test_a_chosen_file_is_used_although_a_sensor_appears_during_the_read(ros_home):
    chosen = store_calibration(ros_home / "chosen.yaml", frame="left")
    files = Elsewhere()
    store = begun_with(chosen, files)
    store.note_sensor("left")
    files.go()
    assert store.calibration is not None


def test_a_missing_chosen_file_is_reported_once(ros_home):
    chosen, files, log = ros_home / "chosen.yaml", Elsewhere(), Lines()
    store = begun_with(chosen, files, log)
    files.go()
    store.note_sensor("left")
    files.go()
    assert len(log) == 1
    assert f"{chosen} does not exist: no calibration is in force" in log[0]


def test_a_chosen_file_of_another_sensor_is_removed_when_the_sensor_appears(ros_home):
    chosen = store_calibration(ros_home / "chosen.yaml", frame="left")
    files = Elsewhere()
    store = begun_with(chosen, files)
    files.go()
    assert store.calibration is not None
    store.note_sensor("right")
    assert store.calibration is None
    assert "made for the magnetometer 'left'" in store.problem


class TestSensor:
    def sensor(self):
        now = [0.0]
        return Sensor("/mag", lambda: now[0]), now

    def test_the_first_message_and_each_new_frame_are_changes(self):
        sensor, _ = self.sensor()
        met = [sensor.note_message(frame) for frame in ("", "", "a", "a", "b", "a")]
        assert met == [True, False, True, False, True, True]

    def test_age_and_silence_follow_the_clock(self):
        sensor, now = self.sensor()
        assert sensor.age() == math.inf
        sensor.note_message("a")
        now[0] = 3.5
        assert sensor.age() == 3.5
        assert sensor.complaint() == "/mag has been silent for 4 s: check its driver and cable"

    def test_alternating_frames_are_a_complaint_until_they_stop(self):
        sensor, _ = self.sensor()
        for k in range(9):
            sensor.note_message("ab"[k % 2])
        words = "the frame of /mag changes between 'a' and 'b': only one can be the sensor"
        assert sensor.complaint() == words
        sensor.look()
        assert sensor.complaint() == words
        sensor.look()
        assert sensor.complaint() == ""

    def test_one_new_frame_is_no_complaint(self):
        sensor, _ = self.sensor()
        for frame in ("", "a", "a"):
            sensor.note_message(frame)
        assert sensor.complaint() == ""


def test_a_slow_disk_and_alternating_frames_delay_no_call(stage, ros_home, monkeypatch):
    for frame in ("left", "right"):
        store_calibration(ros_home / "magcal" / f"calibrator.{frame}.yaml", frame=frame)
    start, disk_answers = [], threading.Event()

    def crawl(path):
        start.append(path)
        disk_answers.wait()
        return read_calibration(path)

    monkeypatch.setattr(calibration_store, "read_calibration", crawl)
    actor = stage(parameters=REFERENCE)
    header = actor.source._field.header
    names = iter(["left", "right"] * 10_000)

    def alternate(sample):
        header.frame_id = next(names)
        return [sample]

    actor.mangle = alternate
    try:
        actor.run(PATIENCE, stop=lambda: bool(start))
        assert actor.answer(actor.call("reset")).success
        words = "the frame of /imu/mag changes between 'left' and 'right'"
        actor.run(PATIENCE, stop=lambda: words in " ".join(actor.status["complaints"]))
        assert words in " ".join(actor.status["complaints"])
    finally:
        disk_answers.set()
