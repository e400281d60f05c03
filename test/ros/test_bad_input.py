"""Bad input of every kind is reported, and the node continues."""

import math

import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, MagneticField
from support import PATIENCE, REFERENCE, calibrate_quickly, store_calibration

from magcal_ros.core.samples import FieldSample, ImuSample

pytestmark = pytest.mark.faults

IMPATIENT = {**REFERENCE, "window.silence_s": 1.0, "window.timeout_s": 3.0}


def every_fourth(replace):
    """Replace each fourth sample by `replace(sample)`, of IMU and field alternately."""
    count = iter(range(10**9))

    def mangle(sample):
        return [replace(sample)] if next(count) % 4 == 0 else [sample]

    return mangle


def with_field(sample, field):
    return sample._replace(field=field) if isinstance(sample, FieldSample) else sample


def assert_alive(actor):
    """The node still answers, and calibrates once the input is good again."""
    actor.mangle = lambda sample: [sample]
    answer = actor.calibrate()
    assert answer.success, answer.message


@pytest.mark.parametrize(
    "bad",
    [pytest.param(bad, marks=pytest.mark.nightly) for bad in (math.nan, math.inf, -math.inf)],
)
def test_samples_that_are_not_finite_are_dropped_and_counted(stage, bad):
    actor = stage()

    def spoil(sample):
        if isinstance(sample, ImuSample):
            return sample._replace(force=(0.0, bad, 9.8))
        return sample._replace(field=(1e-5, bad, 0.0))

    actor.mangle = every_fourth(spoil)
    answer = actor.calibrate()
    assert answer.success, answer.message
    actor.run(1.5)
    assert actor.status["dropped"]["imu"]["not_finite"] > 100
    assert actor.status["dropped"]["field"]["not_finite"] > 50
    assert np.isfinite(actor.yaws).all()
    assert any("not finite" in words for words in actor.status["complaints"])


@pytest.mark.nightly
def test_an_all_zero_field_is_refused_by_name(stage):
    actor = stage(parameters=IMPATIENT)
    actor.mangle = lambda sample: [with_field(sample, (0.0, 0.0, 0.0))]
    answer = actor.calibrate()
    assert not answer.success
    assert "all zero" in answer.message
    assert_alive(actor)


def test_invalid_bytes_are_dropped_and_counted(loaded):
    actor = loaded()
    for kind, topic in ((Imu, "imu/data_raw"), (MagneticField, "imu/mag")):
        vandal = actor.node.create_publisher(kind, topic, 10)
        whole = serialize_message(kind())
        for _ in range(20):
            for damaged in (b"", b"\0\1", whole[:40], b"\0\1\0\0" + b"\xff" * 300):
                vandal.publish(damaged)
            actor.run(0.05)

    def unreadable(sensor):
        return actor.status["dropped"].get(sensor, {}).get("unreadable", 0)

    actor.run(PATIENCE, stop=lambda: min(unreadable("imu"), unreadable("field")) > 20)
    assert min(unreadable("imu"), unreadable("field")) > 20
    actor.yaws.clear()
    actor.run(PATIENCE, stop=lambda: actor.yaws)
    assert actor.yaws


@pytest.mark.nightly
@pytest.mark.parametrize(("factor", "unit"), [(1e6, "microtesla"), (1e4, "gauss")])
def test_a_field_in_another_unit_is_named(stage, factor, unit):
    actor = stage(parameters=IMPATIENT)

    def scale(sample):
        if isinstance(sample, ImuSample):
            return [sample]
        return [sample._replace(field=tuple(factor * value for value in sample.field))]

    actor.mangle = scale
    answer = actor.calibrate()
    assert not answer.success
    assert f"looks like {unit} published as tesla" in answer.message


def test_a_missing_imu_is_reported_with_the_topic(stage):
    actor = stage(parameters=IMPATIENT)
    actor.mangle = lambda sample: [] if isinstance(sample, ImuSample) else [sample]
    answer = actor.calibrate()
    assert not answer.success
    assert "nothing has arrived on /imu/data_raw" in answer.message


def complaints(actor):
    return actor.status.get("complaints", [])


def test_a_topic_of_another_type_is_named(stage):
    actor = stage(parameters=IMPATIENT)
    actor.mangle = lambda sample: [sample] if isinstance(sample, ImuSample) else []
    actor.node.destroy_publisher(actor.source._field_out)
    # DDS refuses a second type of a topic in the same participant.
    context = Context()
    context.init()
    try:
        driver = rclpy.create_node("driver", context=context)
        driver.create_publisher(Imu, "imu/mag", 10)
        actor.run(PATIENCE, stop=lambda: any("published there" in c for c in complaints(actor)))
        answer = actor.calibrate()
    finally:
        context.shutdown()
    assert not answer.success
    wrong = "sensor_msgs/msg/Imu is published there, not sensor_msgs/msg/MagneticField"
    assert f"nothing has arrived on /imu/mag: {wrong}" in answer.message


@pytest.mark.nightly
def test_stamps_that_are_zero_or_go_backward_are_counted(stage):
    actor = stage()
    count = iter(range(10**9))

    def mangle(sample):
        k = next(count)
        if k % 5 == 0:
            return [sample._replace(stamp=0.0)]
        return [sample._replace(stamp=sample.stamp - 3.0)] if k % 5 == 1 else [sample]

    actor.mangle = mangle
    answer = actor.calibrate()
    assert answer.success, answer.message
    actor.run(1.5)
    for sensor in ("imu", "field"):
        assert actor.status["dropped"][sensor]["zero_stamp"] > 50
        assert actor.status["dropped"][sensor]["backward_stamp"] > 50


@pytest.mark.nightly
def test_repeated_field_samples_do_no_harm_and_are_counted(stage):
    actor = stage()
    last = {}

    def mangle(sample):
        if not isinstance(sample, FieldSample):
            return [sample]
        # Every second one repeats the one before.
        repeated = last.pop("field", None)
        if repeated is None:
            last["field"] = sample.field
        return [sample if repeated is None else sample._replace(field=repeated)]

    actor.mangle = mangle
    answer = actor.calibrate()
    assert answer.success, answer.message
    actor.run(1.5)
    assert actor.status["dropped"]["field"]["repeated"] > 100


@pytest.mark.nightly
def test_an_imu_with_another_clock_is_reported(stage):
    actor = stage(parameters=IMPATIENT)
    actor.mangle = lambda s: [s._replace(stamp=s.stamp - 7.0) if isinstance(s, ImuSample) else s]
    answer = actor.calibrate()
    assert not answer.success
    # A message is up to a tenth of a second older than the other sensor's.
    assert "+7.0 s apart" in answer.message or "+6.9 s apart" in answer.message


def test_parameters_out_of_range_are_reported_and_replaced(start_node, actor):
    node = start_node({**REFERENCE, "reference.declination_deg": 999.0, "method": "magic"})
    assert math.isnan(node.get_parameter("reference.declination_deg").value)
    assert node.get_parameter("method").value == "maximum_likelihood"
    robot = actor()
    assert robot.status["north"] == "magnetic"


def test_an_unwritable_path_is_reported_and_the_calibration_stays_in_force(stage):
    actor = stage(parameters={**REFERENCE, "calibration_file": "/proc/no/such/place.yaml"})
    answer = calibrate_quickly(actor)
    assert not answer.success
    assert "not saved: cannot write /proc/no/such/place.yaml" in answer.message
    assert actor.status["state"] == "calibrated"


def test_a_truncated_file_is_refused_and_the_node_runs_uncalibrated(stage, tmp_path):
    path = tmp_path / "calibration.yaml"
    path.write_text("format: magcal_ros/calibration\nformat_version: 1\nhard_ir")
    actor = stage(parameters={**REFERENCE, "calibration_file": str(path)})
    assert actor.status["state"] == "uncalibrated"
    refused = actor.answer(actor.call("load"))
    assert not refused.success
    assert "not a usable calibration" in refused.message
    assert path.read_text().endswith("hard_ir")


def test_a_calibration_of_another_sensor_is_refused(stage, ros_home):
    actor = stage()
    actor.run(0.3)
    store_calibration(ros_home / "magcal" / "calibrator.mag_link.yaml", frame="another_sensor")
    refused = actor.answer(actor.call("load"))
    assert not refused.success
    assert "made for the magnetometer 'another_sensor'" in refused.message
