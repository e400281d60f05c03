"""A robot at rest at known headings, over real middleware."""

import math

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Quaternion
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu
from support import PATIENCE, REFERENCE, rms_deg

from magcal_ros.core.samples import FieldSample
from magcal_ros.files import read_calibration

DECLINATION = 10.0
SPEED = 8.0
PLACE = {**REFERENCE, "reference.declination_deg": DECLINATION}
DOCKS = (20.0, 140.0, 260.0)
"""ENU yaw to magnetic north, degrees."""


def tell(actor, **values):
    """Set the parameters of a known heading, as `ros2 param set` does."""
    if not hasattr(actor, "parameters"):
        # One for all: its six services are waited for with every message.
        actor.parameters = AsyncParameterClient(actor.node, "calibrator")
        assert actor.parameters.wait_for_services(PATIENCE)
    future = actor.parameters.set_parameters(
        [Parameter(f"known_heading.{name}", value=value) for name, value in values.items()]
    )
    actor.run(PATIENCE, stop=future.done)
    for result in future.result().results:
        assert result.successful, result.reason


def dock(actor, heading, reported=lambda yaw: yaw, north="magnetic_north"):
    """Turn to about a heading (degrees) and give it to the node; returns the answer."""
    way = math.remainder(math.radians(heading) - actor.ride.magnetic_yaw, math.tau)
    goal = actor.ride.magnetic_yaw + way
    rate = math.copysign(1.0, way)

    def is_there():
        return math.remainder(goal - actor.ride.magnetic_yaw, math.tau) * rate < 0.05

    actor.run(PATIENCE, rate, is_there)
    actor.run(0.3)
    yaw = reported(math.degrees(actor.ride.magnetic_yaw))
    tell(actor, yaw_deg=math.remainder(yaw, 360.0), north=north, sigma_deg=1.0)
    return actor.answer(actor.call("calibrate_at_heading"))


@pytest.mark.nightly
def test_three_known_headings_calibrate_a_robot_that_never_turns(stage, ros_home):
    actor = stage(parameters=PLACE, speed=SPEED)
    nothing = actor.answer(actor.call("calibrate_at_heading"))
    assert not nothing.success
    assert "known_heading.yaw_deg" in nothing.message
    tell(actor, yaw_deg=0.0)
    unsaid = actor.answer(actor.call("calibrate_at_heading"))
    assert not unsaid.success
    assert "north of known_heading.yaw_deg is not given" in unsaid.message
    first = dock(actor, DOCKS[0])
    assert first.success, first.message
    assert "roughly from one known heading" in first.message
    assert "One more known heading" in first.message
    # True north is told for the second: 10° less, as the magnetic one lies to the east of it.
    second = dock(actor, DOCKS[1], lambda yaw: yaw - DECLINATION, "true_north")
    assert second.success, second.message
    third = dock(actor, DOCKS[2])
    assert third.success, third.message
    assert "from 3 known headings" in third.message
    assert len(actor.status["known_headings"]["headings"]) == 3
    errors = actor.published_errors([(0.0, 0.0)], headings=2)
    assert rms_deg(errors) < 2.0
    stored, _ = read_calibration(ros_home / "magcal" / "calibrator.mag_link.yaml")
    assert stored.evidence.method == "known_headings"


@pytest.mark.nightly
def test_a_mirrored_heading_is_named_and_the_calibration_stays_in_force(stage):
    actor = stage(parameters=REFERENCE, speed=SPEED)
    for heading in DOCKS[:2]:
        assert dock(actor, heading).success
    before = actor.status["calibration"]
    wrong = dock(actor, DOCKS[2], lambda yaw: yaw + 60.0)
    assert not wrong.success
    assert "Known heading 3 of 3" in wrong.message
    assert "contradicts the others" in wrong.message
    assert actor.status["calibration"] == before
    assert actor.answer(actor.call("reset")).success
    assert dock(actor, DOCKS[0], lambda yaw: -yaw).success
    mirrored = dock(actor, DOCKS[1], lambda yaw: -yaw)
    assert not mirrored.success
    assert "mirrored" in mirrored.message


@pytest.mark.nightly
def test_a_heading_that_contradicts_the_calibration_in_force_is_refused(loaded):
    actor = loaded(speed=SPEED)
    agreed = dock(actor, 70.0)
    assert agreed.success
    assert "it is kept" in agreed.message
    wrong = dock(actor, 70.0, lambda yaw: yaw + 40.0)
    assert not wrong.success
    assert "40° further to the right" in wrong.message


def test_a_robot_that_turns_during_the_measurement_is_refused(stage):
    actor = stage(parameters=REFERENCE, speed=SPEED)
    tell(actor, yaw_deg=10.0, north="magnetic_north")
    future = actor.call("calibrate_at_heading")
    actor.run(PATIENCE, 0.3, future.done)
    assert not future.result().success
    assert "stand still" in future.result().message


class Antennas:
    """Two antennas of an actor's robot: its heading to true north at 10 Hz."""

    def __init__(self, actor, read=lambda yaw: yaw):
        self._actor, self._read, self.variance = actor, read, math.radians(1.0) ** 2
        self.late = 0.0
        self._out = actor.node.create_publisher(Imu, "heading", qos_profile_sensor_data)
        self._timer = actor.node.create_timer(0.1 / actor.speed, self._publish)

    def _publish(self):
        ride = self._actor.ride
        half = 0.5 * self._read(ride.magnetic_yaw - math.radians(DECLINATION))
        message = Imu(orientation=Quaternion(z=math.sin(half), w=math.cos(half)))
        sec, nanosec = divmod(round((ride.stamp - self.late) * 1e9), 10**9)
        message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
        message.orientation_covariance[8] = self.variance
        self._out.publish(message)

    def fall_silent(self):
        self._timer.cancel()


def seconds(message):
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def test_the_topic_gives_the_heading_without_a_parameter(stage):
    actor = stage(parameters={**PLACE, "self_calibration": "off"}, speed=SPEED)
    antennas = Antennas(actor)
    antennas.variance = 1e6
    actor.run(1.0)
    lost = actor.answer(actor.call("calibrate_at_heading"))
    assert not lost.success
    assert "yaw is not known" in lost.message
    antennas.variance = math.radians(1.0) ** 2
    actor.run(PATIENCE, stop=lambda: actor.status["known_headings"] is not None)
    answer = actor.answer(actor.call("calibrate_at_heading"))
    assert answer.success, answer.message
    assert "from one known heading" in answer.message
    (reported,) = actor.status["known_headings"]["headings"]
    assert reported.endswith("±1.0° to magnetic north")


def test_antennas_calibrate_the_compass_and_the_fused_yaw_continues_without_them(stage):
    actor = stage(parameters=PLACE, speed=SPEED)
    fused = []
    actor.node.create_subscription(Imu, "compass/fused/enu/imu", fused.append, 10)
    antennas = Antennas(actor)

    def turns_and_stands():
        return 0.6 if actor.ride.stamp % 4.0 < 2.0 else 0.0

    actor.run(PATIENCE, turns_and_stands, lambda: actor.status["state"] == "calibrated")
    assert actor.status["calibration"]["method"] == "known_headings"
    antennas.fall_silent()
    actor.run(20.0 / SPEED, turns_and_stands)
    # On a busy machine messages of the last turn may still be under way.
    stands_since = actor.ride.stamp
    actor.run(PATIENCE, stop=lambda: bool(fused) and seconds(fused[-1]) > stands_since)
    q = fused[-1].orientation
    true = actor.ride.magnetic_yaw - math.radians(DECLINATION)
    assert abs(math.remainder(2.0 * math.atan2(q.z, q.w) - true, math.tau)) < math.radians(6.0)
    assert not actor.status["known_headings"]["topic"]["speaks"]


def test_field_samples_between_those_of_the_imu_are_collected(stage):
    actor = stage(parameters=PLACE, speed=SPEED)
    step = actor.ride.step

    def step_with_later_field(*arguments, **options):
        return [
            each._replace(stamp=each.stamp + 0.003) if isinstance(each, FieldSample) else each
            for each in step(*arguments, **options)
        ]

    actor.ride.step = step_with_later_field
    Antennas(actor)
    actor.run(PATIENCE, stop=lambda: actor.status["known_headings"] is not None)
    actor.run(PATIENCE, stop=lambda: actor.status["known_headings"]["topic"]["kept"] > 0)
    assert actor.status["known_headings"]["topic"]["kept"] > 0


@pytest.mark.parametrize(
    ("late", "words"), [(5.0, "s before those of"), (-5.0, "s after those of")]
)
def test_headings_by_another_clock_are_named_and_not_used(late, words, stage):
    actor = stage(parameters=PLACE, speed=SPEED)
    stated = []
    actor.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda array: stated.append(str(array.status)), 10
    )
    Antennas(actor).late = late
    actor.run(PATIENCE, 0.5, lambda: any(words in each for each in stated))
    assert any(words in each and "the same clock" in each for each in stated)
    lost = actor.answer(actor.call("calibrate_at_heading"))
    assert not lost.success
    assert words in lost.message


def test_mirrored_antennas_are_named_and_calibrate_nothing(stage):
    actor = stage(parameters=PLACE, speed=SPEED)
    stated = []
    actor.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda array: stated.append(str(array.status)), 10
    )
    Antennas(actor, lambda yaw: -yaw)
    actor.run(PATIENCE, 0.5, lambda: any("antennas are mirrored" in each for each in stated))
    assert actor.status["state"] == "uncalibrated"


def test_what_used_mirrored_antennas_is_forgotten_when_they_are_named(loaded):
    """They turn the fused yaw for some seconds, until the gyro shows that they are wrong."""
    actor = loaded(parameters={**PLACE, "known_heading.topic_north": "true_north"})
    received, stated = [], []
    actor.node.create_subscription(Imu, "compass/fused/enu/imu", received.append, 100)
    actor.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda array: stated.append(str(array.status)), 10
    )
    Antennas(actor, lambda yaw: 0.5 * math.pi - yaw)
    actor.run(PATIENCE, 0.5, lambda: any("antennas are mirrored" in each for each in stated))
    turned_until = actor.ride.stamp
    actor.run(PATIENCE, stop=lambda: bool(received) and seconds(received[-1]) > turned_until)
    q = received[-1].orientation
    true = actor.ride.magnetic_yaw - math.radians(DECLINATION)
    assert abs(math.remainder(2.0 * math.atan2(q.z, q.w) - true, math.tau)) < math.radians(3.0)
    assert actor.status["known_headings"]["topic"]["kept"] == 0
    actor.run(PATIENCE, stop=lambda: "mirrored" in stated[-1])
    assert "differs from the fused yaw" not in stated[-1]


@pytest.mark.nightly
def test_antennas_mounted_across_are_named_before_a_calibration(stage):
    actor = stage(parameters=PLACE, speed=SPEED, imu_rate=50.0)
    stated = []
    actor.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda array: stated.append(str(array.status)), 10
    )
    Antennas(actor, lambda yaw: yaw + 0.5 * math.pi)

    def turns_and_stands():
        return 0.6 if actor.ride.stamp % 4.0 < 2.0 else 0.0

    actor.run(PATIENCE, turns_and_stands, lambda: any("quarter turn" in each for each in stated))
    assert any("quarter turn" in each for each in stated)
    assert actor.status["state"] == "uncalibrated"


@pytest.mark.nightly
@pytest.mark.parametrize("calibrated", [True, False])
def test_antennas_to_the_other_north_are_named(calibrated, stage, loaded):
    """By the mounting that they find, also where a calibration from a turn stays in force."""
    mode = {"self_calibration": "off"} if calibrated else {}
    actor = (loaded if calibrated else stage)(parameters={**PLACE, **mode}, speed=SPEED)
    stated = []
    actor.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda array: stated.append(str(array.status)), 10
    )
    Antennas(actor, lambda yaw: yaw + math.radians(DECLINATION))

    def turns_and_stands():
        return 0.6 if actor.ride.stamp % 4.0 < 2.0 else 0.0

    words = "the headings are to magnetic north and not to true north"
    actor.run(PATIENCE, turns_and_stands, lambda: any(words in each for each in stated))
    assert any(words in each for each in stated), stated[-1]
    if calibrated:
        assert actor.status["calibration"]["method"] != "known_headings"
