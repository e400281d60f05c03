"""Turns of a robot that rests, turns at a varying rate, and rests again."""

import math

import numpy as np
from simulated.turns import Motion, measure, smooth_wobble

from magcal_ros.core import Mounting
from magcal_ros.core.geometry import exp_rotations, rotation_about
from magcal_ros.core.samples import FieldSample, ImuSample, Pair
from magcal_ros.core.session import Limits, Session
from magcal_ros.core.simulation import DEGREE, Robot

UP = np.array([0.0, 0.0, 1.0])
STEP, SECONDS, REST = 1.0 / 30.0, 20.0, 3.0
ROBOT = Robot(noise_field=0.3e-6, noise_force=0.05, noise_rate=2e-3)


def evenly(time):
    return np.clip(np.minimum(time, SECONDS - time) / 0.5, 0.0, 1.0)


def unevenly(time):
    return evenly(time) * (1.0 + 0.5 * np.sin(math.tau * time / 7.0))


def stop_and_go(time):
    return evenly(time) * np.clip(4.0 * np.sin(math.tau * time / 5.0) + 2.0, 0.0, 1.0)


def there_and_back(time):
    return np.where((time > 0.0) & (time < SECONDS), np.sin(math.tau * time / SECONDS), 0.0)


def driven(course, robot=ROBOT, rest=REST, seed=1):
    """The motion of slightly more than a full turn with sway, and its measurements."""
    rng = np.random.default_rng(seed)
    time = np.arange(-rest, SECONDS + rest, STEP)
    rate = course(time)
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * STEP)])
    yaw *= 1.05 * math.tau / np.ptp(yaw)
    sway = smooth_wobble(rng, len(time), time[-1] - time[0], DEGREE, (0.2, 2.0))
    attitude = exp_rotations(sway * np.minimum(rate, 1.0)[:, None]) @ rotation_about(UP, -yaw)
    motion = Motion(time, attitude)
    return motion, measure(robot, motion, rng, gyro=True)


def collected(window, gyro=None):
    """The window that a session collects."""
    session = Session(Limits(), Mounting(), 0.0, gyro)
    rates = window.angular_rate
    rates = np.full_like(window.field, math.nan) if rates is None else rates
    speeds = np.full(len(window), math.nan) if window.speed is None else window.speed
    for stamp, field, force, rate, speed in zip(
        window.time, window.field, window.specific_force, rates, speeds, strict=True
    ):
        imu = ImuSample(stamp, tuple(force), tuple(rate))
        session.add(Pair(FieldSample(stamp, tuple(field)), imu), stamp, speed)
    return session.window()
