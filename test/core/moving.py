"""Rides with acceleration, tilt and disturbance, to test what follows a moving robot."""

import math

import numpy as np

from magcal_ros.core.geometry import crossed
from magcal_ros.core.samples import ImuSample
from magcal_ros.core.simulation import Ride, Robot

DEGREE = math.pi / 180.0
FORWARD, LEFT = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
ROBOT = Robot(
    strength=48e-6,
    inclination=65.0 * DEGREE,
    noise_field=0.3e-6,
    noise_force=0.05,
    noise_rate=2e-3,
    gyro_bias=np.array([0.003, -0.002, 0.004]),
)


class Course:
    """Drives a ride and passes every sample to a listener."""

    def __init__(self, listener, robot=ROBOT, seed=1, rate=100.0, gyro=True):
        rng = np.random.default_rng(seed)
        self.ride = Ride(robot, rng, start=10.0, imu_rate=rate, gyro=gyro)
        self.listener = listener
        self.rate = rate

    def go(self, seconds, **motion):
        for _ in range(int(seconds * self.rate)):
            for sample in self.ride.step(**motion):
                self.listener(sample, self.ride)

    def circle(self, seconds, rate=0.5, speed=3.0):
        self.go(seconds, yaw_rate=rate, acceleration=rate * speed * LEFT)


class TiltErrors:
    """A listener that records the errors of a follower's up, degrees."""

    def __init__(self, follower):
        self.follower = follower
        self.errors = []
        self.sigmas = []

    def __call__(self, sample, ride):
        if not isinstance(sample, ImuSample):
            self.follower.add_field(sample.stamp, sample.field)
            return
        self.take(sample, ride)

    def take(self, sample, ride, measured=None):
        self.follower.add(sample, measured)
        up = self.follower.at(sample.stamp, 0.2)
        sine = np.linalg.norm(crossed(np.array(up.direction), ride.attitude[:, 2]))
        self.errors.append(math.degrees(math.asin(min(1.0, sine))))
        self.sigmas.append(math.degrees(math.sqrt(2.0 * up.variance)))

    def rms(self, last=None):
        chosen = self.errors if last is None else self.errors[-last:]
        return math.sqrt(np.mean(np.square(chosen)))
