"""Odometry and a receiver of a driving robot, over real middleware."""

import json
import math
import time

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu, MagneticField, NavSatFix
from simulated.drive import Vehicle, simulated_drive
from simulated.legs import city
from simulated.travel import travel
from std_msgs.msg import String
from std_srvs.srv import Trigger
from support import PATIENCE, REFERENCE, store_calibration
from theatre import FARTHEST_AHEAD, LOST_AFTER

from magcal_ros.core.samples import (
    FieldSample,
    ImuSample,
    PositionSample,
    SpeedSample,
    VelocitySample,
)
from magcal_ros.core.simulation import Robot
from magcal_ros.files import read_calibration
from magcal_ros.ros.sensor_frames import LATCHED

DEGREE = math.pi / 180.0
VEHICLE = Vehicle(Robot(noise_force=0.05, noise_rate=2e-3), imu_yaw=8.0 * DEGREE)


def stamped(kind, stamp, frame):
    message = kind()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(stamp * 1e9), 10**9)
    message.header.frame_id = frame
    return message


class Car:
    """Publishes a drive as fast as the node receives it, and collects its status."""

    KINDS = (
        (ImuSample, Imu, "imu/data_raw"),
        (FieldSample, MagneticField, "imu/mag"),
        (SpeedSample, Odometry, "odom"),
        (VelocitySample, TwistStamped, "gps/vel"),
        (PositionSample, NavSatFix, "gps/fix"),
    )

    def __init__(self, audience):
        self.node, self._inputs = rclpy.create_node("car"), audience._inputs
        self.status = {}
        self.node.create_subscription(String, "calibrator/status", self._on_status, LATCHED)
        self.outs = {
            kind: self.node.create_publisher(message, topic, qos_profile_sensor_data)
            for kind, message, topic in self.KINDS
        }
        self.run(PATIENCE, stop=lambda: all(o.get_subscription_count() for o in self.outs.values()))

    def _on_status(self, message):
        self.status = json.loads(message.data)

    def run(self, seconds, stop=lambda: False):
        end = time.monotonic() + seconds
        while time.monotonic() < end and not stop():
            rclpy.spin_once(self.node, timeout_sec=0.002)

    def drive(self, samples):
        self._under_way, self._arrived = 0, self._count()
        for count, sample in enumerate(samples):
            self.publish(sample)
            if count % 10 == 0:
                self.run(0.003)
            self._under_way += isinstance(sample, (ImuSample, FieldSample))
            if self._is_ahead_by(FARTHEST_AHEAD):
                self.run(LOST_AFTER, stop=lambda: not self._is_ahead_by(FARTHEST_AHEAD // 2))
                if self._is_ahead_by(FARTHEST_AHEAD // 2):
                    self._under_way = 0

    def _count(self):
        return self._inputs.imu.messages + self._inputs.field.messages

    def _is_ahead_by(self, messages):
        before, self._arrived = self._arrived, self._count()
        self._under_way = max(0, self._under_way - (self._arrived - before))
        return self._under_way > messages

    def publish(self, sample):
        message = getattr(self, "_" + type(sample).__name__.lower())(sample)
        self.outs[type(sample)].publish(message)

    def _imusample(self, sample):
        message = stamped(Imu, sample.stamp, "imu_link")
        acceleration, rate = message.linear_acceleration, message.angular_velocity
        acceleration.x, acceleration.y, acceleration.z = sample.force
        rate.x, rate.y, rate.z = sample.rate
        return message

    def _fieldsample(self, sample):
        message = stamped(MagneticField, sample.stamp, "mag_link")
        field = message.magnetic_field
        field.x, field.y, field.z = sample.field
        return message

    def _speedsample(self, sample):
        message = stamped(Odometry, sample.stamp, "odom")
        message.child_frame_id = "base_link"
        message.twist.twist.linear.x = sample.speed
        return message

    def _velocitysample(self, sample):
        message = stamped(TwistStamped, sample.stamp, "gps")
        message.twist.linear.x, message.twist.linear.y = sample.east, sample.north
        return message

    def _positionsample(self, sample):
        message = stamped(NavSatFix, sample.stamp, "gps")
        message.status.status = 0
        message.latitude = 48.0 + math.degrees(sample.north / 6_371_000.0)
        shrink = math.cos(math.radians(48.0))
        message.longitude = 11.0 + math.degrees(sample.east / 6_371_000.0 / shrink)
        return message


@pytest.fixture
def drive():
    rng = np.random.default_rng(4)
    return simulated_drive(travel(city(rng, 70.0), rng, rate=25.0), rng, VEHICLE)


@pytest.fixture
def car(start_node, tmp_path):
    """Return a function that starts the node with a calibration, and a car."""
    cars = []

    def set_up(lines=""):
        path = store_calibration(tmp_path / "calibration.yaml")
        path.write_text(path.read_text() + lines)
        cars.append(Car(start_node({**REFERENCE, "calibration_file": str(path)})))
        cars[0].path = path
        return cars[0]

    yield set_up
    for each in cars:
        each.node.destroy_node()


def test_the_yaw_of_the_imu_is_found_by_odometry_reported_and_stored(car, drive):
    car = car()
    car.run(PATIENCE, stop=lambda: car.status)
    assert car.status["vehicle_yaw_offset"] is None
    assert car.status["drive"] is None
    car.drive(drive.samples())
    car.run(PATIENCE, stop=lambda: car.status["vehicle_yaw_offset"])
    reported = car.status["vehicle_yaw_offset"]
    assert reported["deg"] == pytest.approx(8.0, abs=3.0 * reported["sigma_deg"])
    assert reported["by"].startswith("accelerations")
    assert car.status["drive"]["speed_from"] == "/odom"
    car.run(PATIENCE, stop=lambda: read_calibration(car.path)[1].vehicle_yaw)
    kept = read_calibration(car.path)[1].vehicle_yaw
    assert kept.offset == pytest.approx(8.0 * DEGREE, abs=3.0 * kept.sigma)


def test_bad_travel_messages_do_no_harm_and_are_named(car):
    car = car()
    for value in (math.nan, math.inf, 1e300):
        car.publish(SpeedSample(5.0, value))
        car.publish(VelocitySample(5.0, value, 0.0, 0.1))
        car.publish(PositionSample(5.0, value, 0.0))
    absent = stamped(Odometry, 5.0, "odom")
    absent.twist.covariance[0] = -1.0
    world = stamped(Odometry, 6.0, "odom")
    world.child_frame_id = "odom"
    for message in (absent, world):
        car.outs[SpeedSample].publish(message)
    car.run(PATIENCE, stop=lambda: car.status.get("state") == "calibrated")
    car.run(0.5)
    assert car.status["state"] == "calibrated"
    assert car.status["vehicle_yaw_offset"] is None


@pytest.mark.nightly
def test_a_window_that_was_a_drive_is_fitted_as_one(start_node, tmp_path):
    """The services of a turn, called in a car in a city: the smoother answers as offline."""
    rng = np.random.default_rng(1)
    drive = simulated_drive(travel(city(rng, 130.0), rng, rate=25.0), rng, VEHICLE)
    path = tmp_path / "calibration.yaml"
    chosen = {"calibration_file": str(path), "self_calibration": "off"}
    car = Car(start_node({**REFERENCE, **chosen}))

    def call(service):
        client = car.node.create_client(Trigger, f"calibrator/{service}")
        assert client.wait_for_service(PATIENCE)
        answer = client.call_async(Trigger.Request())
        car.run(PATIENCE, stop=answer.done)
        return answer.result()

    assert call("start").success
    car.drive(drive.samples())
    answer = call("finish")
    assert answer.success, answer.message
    assert "of movement" in answer.message
    found, _ = read_calibration(path)
    assert found.evidence.method == "maximum_likelihood"
    apart = 1e6 * (found.correction.hard_iron - VEHICLE.robot.hard_iron)
    assert np.abs(apart[:2]).max() < 4.0
    car.node.destroy_node()


def test_the_stored_yaw_is_reported_at_the_next_start(car):
    car = car("vehicle_yaw_offset: {yaw: 0.1, sigma: 0.01, source: course}\n")
    car.run(PATIENCE, stop=lambda: car.status.get("vehicle_yaw_offset"))
    assert car.status["vehicle_yaw_offset"]["deg"] == pytest.approx(5.73, abs=0.01)
