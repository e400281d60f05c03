"""`magcal check` uses course where a bag has fixes."""

import json
import math

import numpy as np
from drives import STORE2, write_bag

from magcal_ros.cli.main import main
from magcal_ros.core.calibration.calibration import Calibration, Evidence
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.samples.travel_samples import PositionSample, SpeedSample
from magcal_ros.core.simulation.drive import Vehicle, simulated_drive
from magcal_ros.core.simulation.legs import city
from magcal_ros.core.simulation.simulator import Robot
from magcal_ros.core.simulation.travel import travel
from magcal_ros.files.calibration_file import Origin, write_calibration

TYPES = STORE2.types
DEGREE = math.pi / 180.0
VEHICLE = Vehicle(
    Robot(strength=48e-6, inclination=65.0 * DEGREE, noise_force=0.05, noise_rate=2e-3),
    imu_yaw=8.0 * DEGREE,
)


def header(stamp, frame):
    time = TYPES["builtin_interfaces/msg/Time"](*divmod(round(stamp * 1e9), 1_000_000_000))
    return TYPES["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def recorded(sample):
    """A sample of the drive as a bag has it."""
    if isinstance(sample, PositionSample):
        status = TYPES["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
        north = 48.0 + math.degrees(sample.north / 6_371_000.0)
        east = 11.0 + math.degrees(sample.east / 6_371_000.0 / math.cos(math.radians(48.0)))
        kind = TYPES["sensor_msgs/msg/NavSatFix"]
        return "/fix", kind(header(sample.stamp, "gps"), status, north, east, 0.0, np.zeros(9), 0)
    if isinstance(sample, SpeedSample):
        vector = TYPES["geometry_msgs/msg/Vector3"]
        pose = TYPES["geometry_msgs/msg/Pose"](
            TYPES["geometry_msgs/msg/Point"](0.0, 0.0, 0.0),
            TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        )
        twist = TYPES["geometry_msgs/msg/Twist"](vector(sample.speed, 0.0, 0.0), vector(0, 0, 0))
        return "/odom", TYPES["nav_msgs/msg/Odometry"](
            header(sample.stamp, "odom"),
            "base_link",
            TYPES["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
            TYPES["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
        )
    return sample if isinstance(sample, (ImuSample, FieldSample)) else None


def test_the_offset_is_told_and_a_bent_calibration_accused(tmp_path, capsys):
    rng = np.random.default_rng(4)
    truth = travel(city(rng, 180.0), rng, rate=10.0)
    drive = simulated_drive(truth, rng, VEHICLE, streets=None)
    bag = write_bag(tmp_path / "bag", [each for each in map(recorded, drive.samples()) if each])
    robot = VEHICLE.with_iron(np.array([8e-6, 0.0, 0.0])).robot
    calibration = Calibration(
        robot.true_correction,
        np.eye(12) * 1e-14,
        5e-7,
        0.01,
        robot.strength,
        robot.inclination,
        Evidence("maximum_likelihood", "good", "good", ""),
    )
    path = tmp_path / "calibration.yaml"
    write_calibration(path, calibration, Origin.now("mag_link", "imu_link"))
    main(["check", str(bag), "--calibration", str(path), "--json", "--output", str(tmp_path / "o")])
    course = json.loads(capsys.readouterr().out)["course"]
    assert course["metres"] > 500
    found = {each["figure"]: each["state"] for each in course["findings"]}
    assert found["course_swing_once"] in ("warn", "refused")
