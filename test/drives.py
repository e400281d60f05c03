"""Simulated drives, written as every kind of recording."""

import math

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="needs rosbags, which writes bags: pip install rosbags")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from simulated import Vehicle

from magcal_ros.core.samples import FieldSample, ImuSample, PositionSample, SpeedSample
from magcal_ros.core.simulation import Ride, Robot

ROBOT = Robot()
IMU, FIELD = "sensor_msgs/msg/Imu", "sensor_msgs/msg/MagneticField"
DRIVE_VEHICLE = Vehicle(
    Robot(strength=48e-6, inclination=math.radians(65.0), noise_force=0.05, noise_rate=2e-3),
    imu_yaw=math.radians(8.0),
)
STORE1, STORE2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)


def drive(turned=400.0, robot=ROBOT, seed=1, start=1000.0, rate=0.5, gyro=True, hertz=25.0):
    """The samples while the robot turns by these degrees, with the IMU at a rate."""
    ride = Ride(robot, np.random.default_rng(seed), start=start, imu_rate=hertz, gyro=gyro)
    steps = max(round(hertz), int(math.radians(turned) / rate * hertz))
    speed = rate if turned else 0.0
    return [sample for _ in range(steps) for sample in ride.step(speed)]


def message(store, sample, frame="imu_link"):
    kinds = store.types
    vector = kinds["geometry_msgs/msg/Vector3"]
    time = kinds["builtin_interfaces/msg/Time"](*divmod(round(sample.stamp * 1e9), 1_000_000_000))
    number = {"seq": 0} if store is STORE1 else {}
    header = kinds["std_msgs/msg/Header"](stamp=time, frame_id=frame, **number)
    none = np.zeros(9)
    if not isinstance(sample, ImuSample):
        return kinds[FIELD](header, vector(*sample.field), none)
    still = kinds["geometry_msgs/msg/Quaternion"](*(sample.orientation or (0.0, 0.0, 0.0, 1.0)))
    absent = np.r_[-1.0, np.zeros(8)]
    has_rate = not math.isnan(sample.rate[0])
    rate = vector(*(sample.rate if has_rate else (0.0, 0.0, 0.0)))
    marks = (none if sample.orientation else absent, none if has_rate else absent)
    return kinds[IMU](header, still, marks[0], rate, marks[1], vector(*sample.force), none)


def text(store, words):
    return store.types["std_msgs/msg/String"](words)


def bag_message(store, sample, frames):
    """The topic of a sample and its message; a pair of topic and message is unchanged."""
    if isinstance(sample, ImuSample):
        return "/imu/data_raw", message(store, sample, frames[0])
    if hasattr(sample, "field"):
        return "/imu/mag", message(store, sample, frames[1])
    return sample


def write_bag(path, samples, kind="mcap", frames=("imu_link", "mag_link"), pace=1.0):
    """Write a rosbag2 (mcap, sqlite3) or a ROS 1 bag; returns its path.

    `pace` is the speed of the recorder's clock against that of the stamps.
    """
    store = STORE1 if kind == "ros1" else STORE2
    if kind == "ros1":
        path = path.with_suffix(".bag")
        writer, serialize = Writer1(path), store.serialize_ros1
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer, serialize = Writer2(path, version=8, storage_plugin=plugin), store.serialize_cdr
    connections, stamp = {}, 0
    with writer:
        for sample in samples:
            topic, content = bag_message(store, sample, frames)
            msgtype = content.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=store)
            stamp = round(sample.stamp * 1e9) if hasattr(sample, "stamp") else stamp
            writer.write(connections[topic], round(pace * stamp), serialize(content, msgtype))
    return path


def write_csv(folder, samples):
    """Write imu.csv and mag.csv, with speeds or places odom.csv or gps.csv; returns the folder."""
    folder.mkdir(parents=True)
    for name, header, kind, row in (
        ("imu.csv", "t,ax,ay,az,gx,gy,gz", ImuSample, lambda s: (s.stamp, *s.force, *s.rate)),
        ("mag.csv", "t,mx,my,mz", FieldSample, lambda s: (s.stamp, *s.field)),
        ("odom.csv", "t,speed", SpeedSample, lambda s: s[:2]),
        ("gps.csv", "t,east,north", PositionSample, lambda s: s),
    ):
        rows = [row(sample) for sample in samples if isinstance(sample, kind)]
        if not rows and kind in (SpeedSample, PositionSample):
            continue
        np.savetxt(folder / name, rows, fmt="%.17g", delimiter=",", header=header, comments="")
    return folder


def header(stamp, frame):
    time = STORE2.types["builtin_interfaces/msg/Time"](*divmod(round(stamp * 1e9), 1_000_000_000))
    return STORE2.types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def recorded(sample):
    """A sample of the drive as a bag has it."""
    if isinstance(sample, PositionSample):
        status = STORE2.types["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
        north = 48.0 + math.degrees(sample.north / 6_371_000.0)
        east = 11.0 + math.degrees(sample.east / 6_371_000.0 / math.cos(math.radians(48.0)))
        kind = STORE2.types["sensor_msgs/msg/NavSatFix"]
        return "/fix", kind(header(sample.stamp, "gps"), status, north, east, 0.0, np.zeros(9), 0)
    if isinstance(sample, SpeedSample):
        vector = STORE2.types["geometry_msgs/msg/Vector3"]
        pose = STORE2.types["geometry_msgs/msg/Pose"](
            STORE2.types["geometry_msgs/msg/Point"](0.0, 0.0, 0.0),
            STORE2.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        )
        twist = STORE2.types["geometry_msgs/msg/Twist"](
            vector(sample.speed, 0.0, 0.0), vector(0, 0, 0)
        )
        return "/odom", STORE2.types["nav_msgs/msg/Odometry"](
            header(sample.stamp, "odom"),
            "base_link",
            STORE2.types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
            STORE2.types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
        )
    return sample if isinstance(sample, (ImuSample, FieldSample)) else None
