"""Invalid messages: the node does not end and publishes finite numbers only."""

import numpy as np
import pytest
from hostile import HandFed, hostile_message
from long_form import rounds
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, MagneticField, NavSatFix
from std_msgs.msg import Float64
from support import REFERENCE, store_calibration

from magcal_ros.ros.node import Calibrator

pytestmark = pytest.mark.faults


@pytest.mark.parametrize(
    "subtracted",
    [0.0, pytest.param(0.01, marks=pytest.mark.nightly)],
    ids=["raw up", "carried up"],
)
def test_thousands_of_invalid_messages_give_no_error_and_no_nan(
    graph, monkeypatch, tmp_path, subtracted
):
    path = store_calibration(tmp_path / "calibration.yaml", subtracted, frame="")
    parameters = {
        **REFERENCE,
        "calibration_file": str(path),
        "report_folder": "none",
        "reference.declination_deg": 3.0,
    }
    node = Calibrator(parameter_overrides=[Parameter(k, value=v) for k, v in parameters.items()])
    fed = HandFed(node, monkeypatch)
    rng = np.random.default_rng(5)
    count = rounds(1200, 50_000)
    for k in range(count):
        fed.feed(hostile_message(rng, 1000.0 + 0.01 * k))
        if k % 400 == 50:
            fed.call("start")
        if k % 100 == 0:
            fed.tick()
        if k % 400 == 399:
            fed.call("finish" if k % 800 == 799 else "cancel")
    assert fed.published[MagneticField] > count / 100
    assert fed.published[Float64] > count / 200
    assert fed.published[Imu] > count / 100
    node.close()
    node.destroy_node()


@pytest.mark.nightly
def test_after_invalid_messages_over_the_middleware_the_node_calibrates(stage):
    actor = stage(speed=8.0)
    assert actor.calibrate().success
    rng = np.random.default_rng(6)
    out = {
        kind: actor.node.create_publisher(kind, topic, 10)
        for kind, topic in (
            (Imu, "imu/data_raw"),
            (MagneticField, "imu/mag"),
            (NavSatFix, "gps/fix"),
        )
    }
    for _ in range(rounds(10, 200)):
        for _ in range(50):
            message = hostile_message(rng, actor.ride.stamp)
            out[type(message)].publish(message)
        actor.run(0.05)
    for publisher in out.values():
        actor.node.destroy_publisher(publisher)
    assert np.isfinite(actor.yaws).all()
    actor.run(0.5)
    answer = actor.calibrate()
    assert answer.success, answer.message
