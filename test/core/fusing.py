"""The compass and the fused yaw of one magnetometer, fed as the node feeds them."""

import numpy as np
from moving import ROBOT
from sample_results import EVIDENCE

from magcal_ros.core import Calibration, Compass
from magcal_ros.core.driving import TravelEstimator
from magcal_ros.core.geometry import wrap_angle
from magcal_ros.core.heading import PATIENCE, CompassReader, FusedYaw
from magcal_ros.core.samples import ImuSample, Streams
from magcal_ros.core.up import UpFollower

CALIBRATED = Calibration(
    ROBOT.true_correction,
    np.zeros((12, 12)),
    ROBOT.noise_field,
    0.005,
    ROBOT.strength,
    ROBOT.inclination,
    EVIDENCE,
)


class Fusing:
    """A listener that processes messages as the node does."""

    def __init__(self, calibration=CALIBRATED, patience=PATIENCE):
        self.compass = Compass(calibration)
        self.streams = Streams(0.2)
        self.follower = UpFollower()
        self.reader = CompassReader(self.follower)
        self.fused = FusedYaw(calibration, patience)
        self.raw, self.found, self.truth = [], [], []
        self.estimator = TravelEstimator()

    def __call__(self, sample, ride=None):
        if isinstance(sample, ImuSample):
            self.on_imu(sample, ride)
        elif self.streams.add_field(sample, self.follower.turned):
            self.follower.add_field(sample.stamp, sample.field)
            unchanged = self.streams.turned_unchanged
            reading = self.reader.read(self.compass, sample, turned_unchanged=unchanged)
            heading = reading.heading
            if heading:
                self.raw.append((sample.stamp, heading.yaw, heading.yaw_variance))
                self.follower.add_yaw(sample.stamp, heading.yaw)
                self.fused.correct(reading)

    def on_imu(self, sample, ride):
        if not self.streams.add_imu(sample):
            return
        own = self.estimator.add_imu(sample, self.follower.gyro_bias.rate)
        self.follower.add(sample, own)
        self.fused.propagate_by(sample.stamp, self.follower)
        heading = self.fused.heading()
        if heading is not None:
            self.found.append((sample.stamp, heading.yaw, heading.yaw_variance))
            if ride is not None:
                self.truth.append(ride.magnetic_yaw)

    def errors_deg(self):
        yaw = np.array(self.found)[:, 1]
        return np.degrees(wrap_angle(yaw - np.array(self.truth)))

    def sigmas_deg(self):
        return np.degrees(np.sqrt(np.array(self.found)[:, 2]))
