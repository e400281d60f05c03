"""The node's topics: frames, stamps, covariances, norths."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu, MagneticField
from support import PATIENCE, REFERENCE, store_calibration
from theatre import open_theatre

from magcal_ros.core.geometry import wrap_angle
from magcal_ros.ros.sensor_frames import LATCHED

DECLINATION = math.radians(7.0)

TOPICS = {
    "field": (MagneticField, "imu/mag_unbiased"),
    "magnetic": (Imu, "compass/mag/enu/imu"),
    "true": (Imu, "compass/true/enu/imu"),
}

SETTLED_WITHIN = 3.0
"""Seconds of the robot's time until the leap to another pose no longer widens the variance."""


@pytest.fixture
def listen():
    """Return a function that collects the messages of a topic for an actor."""

    def subscribe(actor, kind, topic, qos=10):
        received = []
        actor.node.create_subscription(kind, topic, received.append, qos)
        return received

    return subscribe


@pytest.fixture(scope="module")
def recorded(calibration_of_the_robot, tmp_path_factory):
    """Return a robot that has left the graph, and what its calibrated node published."""
    parameters = {**REFERENCE, "reference.declination_deg": 7.0}
    with open_theatre() as theatre:
        folder = tmp_path_factory.mktemp("recorded")
        actor = theatre.loaded(calibration_of_the_robot, folder, parameters=parameters)
        actor.sent = set()

        def remember(sample):
            actor.sent.add(round(sample.stamp * 1e9))
            return [sample]

        actor.mangle = remember
        received = {name: [] for name in TOPICS}
        for name, (kind, topic) in TOPICS.items():
            actor.node.create_subscription(kind, topic, received[name].append, 10)
        actor.ride.stand(math.radians(5.0), math.radians(-3.0), 0.7)
        settled = 1e9 * (actor.ride.stamp + SETTLED_WITHIN)
        actor.run(PATIENCE, stop=lambda: any(_nanoseconds(m) > settled for m in received["true"]))
        actor.yaws.clear()
        for messages in received.values():
            messages.clear()
        actor.run(PATIENCE, stop=lambda: min(len(actor.yaws), *map(len, received.values())) >= 100)
        return actor, received


def quaternion(message):
    q = message.orientation
    return [q.x, q.y, q.z, q.w]


def test_the_outputs_agree_with_the_truth_and_with_each_other(recorded):
    actor, received = recorded
    body_to_enu = Rotation.from_quat([quaternion(m) for m in received["magnetic"]]).mean()
    yaw, pitch, roll = body_to_enu.as_euler("ZYX")
    truth = actor.ride.magnetic_yaw
    assert abs(float(wrap_angle(yaw - truth))) < math.radians(1.0)
    assert roll == pytest.approx(math.radians(5.0), abs=2e-3)
    assert pitch == pytest.approx(math.radians(-3.0), abs=2e-3)
    magnetic = {_nanoseconds(m): quaternion(m) for m in received["magnetic"]}
    both = [message for message in received["true"] if _nanoseconds(message) in magnetic]
    assert len(both) > 20
    for message in both:
        turned = Rotation.from_quat(magnetic[_nanoseconds(message)]).as_euler("ZYX")[0]
        true = Rotation.from_quat(quaternion(message)).as_euler("ZYX")[0]
        assert float(wrap_angle(turned - true)) == pytest.approx(DECLINATION, abs=1e-9)
    mean_yaw = float(np.mean(actor.yaws))
    assert mean_yaw == pytest.approx(float(wrap_angle(yaw - DECLINATION)), abs=2e-3)


def test_stamps_are_the_fields_and_frames_are_the_imus(recorded):
    actor, received = recorded
    for topic in ("field", "magnetic", "true"):
        assert received[topic]
        assert {message.header.frame_id for message in received[topic]} == {"imu_link"}
        assert {_nanoseconds(message) for message in received[topic]} <= actor.sent


def test_the_compensated_field_is_the_earths_in_body_axes(recorded):
    actor, received = recorded
    field = np.mean([_vector(message.magnetic_field) for message in received["field"]], axis=0)
    truth = actor.ride.attitude @ actor.robot.field_enu
    assert np.linalg.norm(field - truth) < 0.6e-6
    assert not np.any(received["field"][0].magnetic_field_covariance)


def test_the_published_variance_is_the_scatter_and_rates_are_marked_absent(recorded):
    actor, received = recorded
    last = received["magnetic"][-1]
    assert last.angular_velocity_covariance[0] == -1.0
    assert last.linear_acceleration_covariance[0] == -1.0
    covariance = np.array(last.orientation_covariance).reshape(3, 3)
    assert np.allclose(covariance, covariance.T)
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    scatter = float(np.std(actor.yaws))
    assert 0.8 * scatter < math.sqrt(covariance[2, 2]) < 2.5 * scatter


def test_a_covariance_of_the_field_is_rotated_into_body_axes(loaded, listen):
    actor = loaded()
    sigma = np.diag([1e-14, 4e-14, 9e-14])
    actor.source._field.magnetic_field_covariance = sigma.ravel()
    received = listen(actor, MagneticField, "imu/mag_unbiased")
    bias = listen(actor, MagneticField, "imu/mag_bias", LATCHED)
    actor.run(PATIENCE, stop=lambda: bias and received)
    a = np.array(bias[-1].magnetic_field_covariance).reshape(3, 3)
    carried = np.array(received[-1].magnetic_field_covariance).reshape(3, 3)
    assert np.allclose(carried, a @ sigma @ a.T, rtol=1e-9, atol=1e-24)
    # As sensor_msgs/Imu marks what is absent; for a field, zeros mean that nothing is known.
    actor.source._field.magnetic_field_covariance = np.array([-1.0, *8 * [0.0]])
    actor.run(
        PATIENCE,
        stop=lambda: not np.array_equal(received[-1].magnetic_field_covariance, carried.ravel()),
    )
    assert not np.any(received[-1].magnetic_field_covariance)


def test_the_bias_is_latched_for_late_joiners_and_repeated(loaded, listen):
    actor = loaded()
    late = listen(actor, MagneticField, "imu/mag_bias", LATCHED)
    actor.run(PATIENCE, stop=lambda: late)
    hard_iron = _vector(late[0].magnetic_field)
    assert np.allclose(hard_iron, actor.robot.hard_iron, atol=0.3e-6)
    assert late[0].header.frame_id == "mag_link"
    actor.run(PATIENCE, stop=lambda: len(late) >= 3)
    assert len(late) >= 3


def test_late_subscribers_are_served_immediately(loaded, listen):
    robot = loaded()
    for kind, topic in ((MagneticField, "imu/mag_unbiased"), (Imu, "compass/mag/enu/imu")):
        late = listen(robot, kind, topic)
        robot.run(PATIENCE, stop=lambda received=late: len(received) > 20)
        assert len(late) > 20


def test_without_declination_there_is_no_true_north(loaded, listen):
    actor = loaded()
    true = listen(actor, Imu, "compass/true/enu/imu")
    magnetic = listen(actor, Imu, "compass/mag/enu/imu")
    actor.run(PATIENCE, stop=lambda: len(magnetic) > 50)
    assert magnetic
    assert not true
    assert actor.status["north"] == "magnetic"
    received = listen(actor, DiagnosticArray, "/diagnostics")

    def is_said():
        parts = [part for each in received for part in each.status]
        return any("compass/true/enu/imu" in part.message for part in parts)

    actor.run(PATIENCE, stop=is_said)
    assert is_said()


def test_diagnostics_give_the_state_of_calibration_field_and_inputs(stage, listen, ros_home):
    actor = stage()
    received = listen(actor, DiagnosticArray, "/diagnostics")
    actor.run(PATIENCE, stop=lambda: received and actor.source.listeners)
    parts = {status.name: status for status in received[-1].status}
    assert set(parts) == {
        "calibrator: Calibration",
        "calibrator: Field",
        "calibrator: Fused",
        "calibrator: Inputs",
        "calibrator: Watch",
    }
    assert parts["calibrator: Calibration"].level == DiagnosticStatus.WARN
    assert "not calibrated" in parts["calibrator: Calibration"].message
    store_calibration(ros_home / "magcal" / "calibrator.mag_link.yaml")
    assert actor.answer(actor.call("load")).success

    def levels():
        return {status.level for status in received[-1].status}

    def field():
        return next(s.message for s in received[-1].status if s.name == "calibrator: Field")

    def all_well():
        return levels() == {DiagnosticStatus.OK} and field()[0].isdigit()

    actor.run(PATIENCE, stop=all_well)
    assert levels() == {DiagnosticStatus.OK}
    assert float(field().split(" ")[0]) == pytest.approx(48.0, abs=1.5)


def _nanoseconds(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def _vector(v):
    return np.array([v.x, v.y, v.z])
