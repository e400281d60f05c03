"""Publishers of any kind and number, late subscribers, and intermittent sensors."""

import json

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import Imu, MagneticField
from std_msgs.msg import String
from support import PATIENCE, assert_silent
from visualization_msgs.msg import MarkerArray

from magcal_ros.core.samples import FieldSample, ImuSample
from magcal_ros.ros.sensor_frames import LATCHED

pytestmark = pytest.mark.faults


@pytest.fixture
def calibrated(loaded):
    """Return a robot whose node has loaded a calibration."""
    actor = loaded()
    actor.run(PATIENCE, stop=lambda: actor.yaws and not actor.status["complaints"])
    assert actor.yaws
    return actor


@pytest.mark.nightly
def test_reliable_and_best_effort_publishers_are_received(calibrated):
    actor = calibrated
    actor.source._imu_out = actor.node.create_publisher(Imu, "imu/data_raw", 10)
    actor.source._field_out = actor.node.create_publisher(MagneticField, "imu/mag", 10)
    actor.run(0.5)
    actor.yaws.clear()
    actor.run(PATIENCE, stop=lambda: len(actor.yaws) > 10)
    assert len(actor.yaws) > 10


def test_two_publishers_on_one_topic_are_reported_until_one_ends(calibrated):
    actor = calibrated
    second = actor.node.create_publisher(MagneticField, "imu/mag", 10)
    actor.run(PATIENCE, stop=lambda: bool(actor.status["complaints"]))
    words = "2 publishers on /imu/mag: only one can be the sensor"
    assert actor.status["complaints"] == [words]
    actor.node.destroy_publisher(second)
    actor.run(PATIENCE, stop=lambda: not actor.status["complaints"])
    assert actor.status["complaints"] == []


@pytest.mark.parametrize(
    ("kind", "topic"),
    [
        (ImuSample, "imu/data_raw"),
        pytest.param(FieldSample, "imu/mag", marks=pytest.mark.nightly),
    ],
)
def test_a_silent_sensor_stops_the_yaw_until_it_returns(calibrated, kind, topic):
    actor = calibrated
    actor.mangle = lambda sample: [] if isinstance(sample, kind) else [sample]
    assert_silent(actor)
    actor.run(PATIENCE, stop=lambda: bool(actor.status["complaints"]))
    assert not actor.yaws
    assert [f"/{topic} has been silent" in words for words in actor.status["complaints"]] == [True]
    actor.mangle = lambda sample: [sample]
    actor.run(PATIENCE, stop=lambda: actor.yaws and not actor.status["complaints"])
    assert actor.yaws
    assert actor.status["complaints"] == []


@pytest.mark.nightly
def test_late_subscribers_get_status_and_markers(stage):
    actor = stage(speed=8.0)
    assert actor.calibrate().success
    actor.run(0.3)
    received = {String: [], MarkerArray: []}
    for kind, topic in ((String, "status"), (MarkerArray, "markers")):
        late = f"/calibrator/{topic}"
        actor.node.create_subscription(kind, late, received[kind].append, LATCHED)
    actor.run(PATIENCE, stop=lambda: all(received.values()))
    assert json.loads(received[String][0].data)["state"] == "calibrated"
    assert "circle" in {marker.ns for marker in received[MarkerArray][0].markers}


@pytest.mark.nightly
def test_a_field_at_a_tenth_of_the_imu_rate_calibrates(stage):
    actor = stage(steps_per_field=10, speed=8.0)
    answer = actor.calibrate()
    assert answer.success, answer.message


def test_another_sensor_is_reported_while_the_calibration_is_of_the_first(calibrated):
    actor = calibrated
    actor.source._field.header.frame_id = "other_\x1b[2J"
    received = []
    actor.node.create_subscription(DiagnosticArray, "/diagnostics", received.append, 10)
    actor.run(PATIENCE, stop=lambda: len(received) > 1)
    message = received[-1].status[0].message
    assert message.startswith("made for the magnetometer 'mag_link', but the field now comes from")
    assert message.isprintable()


def test_a_frozen_gyro_is_named_until_it_measures_again(calibrated):
    actor = calibrated
    received, frozen = [], []
    actor.node.create_subscription(DiagnosticArray, "/diagnostics", received.append, 10)

    def freeze(sample):
        if isinstance(sample, ImuSample):
            frozen.append(sample.rate)
            sample = sample._replace(rate=frozen[0])
        return [sample]

    def inputs():
        found = [each for each in received[-1].status if each.name.endswith(": Inputs")]
        return found[0]

    actor.mangle = freeze
    actor.run(1.0)
    words = "/imu/data_raw repeats one turn rate although the compass has turned by "
    actor.run(PATIENCE, 0.5, stop=lambda: words in inputs().message)
    assert words in inputs().message
    assert inputs().level == DiagnosticStatus.ERROR
    assert inputs().message.endswith("Restart the driver of the IMU")
    actor.mangle = lambda sample: [sample]
    actor.run(PATIENCE, stop=lambda: words not in inputs().message)
    assert words not in inputs().message


def test_another_imu_is_reported_while_the_calibration_is_of_the_first(calibrated):
    actor = calibrated
    received = []
    actor.node.create_subscription(DiagnosticArray, "/diagnostics", received.append, 10)
    actor.run(PATIENCE, stop=lambda: len(received) > 1)
    assert "imu_link" not in received[-1].status[0].message
    actor.source._imu.header.frame_id = "spare_imu"
    actor.run(PATIENCE, stop=lambda: "spare_imu" in received[-1].status[0].message)
    status = received[-1].status[0]
    assert "in the axes of 'imu_link', but the IMU's frame is 'spare_imu'" in status.message
    assert status.level == DiagnosticStatus.WARN
    assert actor.answer(actor.call("reset")).success
    actor.run(PATIENCE, stop=lambda: "spare_imu" not in received[-1].status[0].message)
    assert "spare_imu" not in received[-1].status[0].message
