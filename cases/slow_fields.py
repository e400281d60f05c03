"""Turns of a shaking robot whose field has a lower rate than its IMU."""

from __future__ import annotations

import math

import numpy as np
from realistic_robots import Scene, drawn_knowledge, usual_robot
from simulated.turns import Motion, measure, slope_rpy, smooth_wobble

from magcal_ros.core.geometry.rotations import exp_rotations, rotation_about, rotation_from_rpy
from magcal_ros.core.knowledge import Knowledge, Mounting
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import FieldSample, ImuSample, Pairer, Streams
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.session import Limits, Session
from magcal_ros.core.simulation import DEGREE, UP_ENU

IMU_HZ = 100.0
SECONDS, REST = 25.0, 2.0
BEGUN = 100.0  # seconds of the first stamp


def drawn(rng: np.random.Generator, shake: float) -> tuple[Scene, Knowledge]:
    """Draw a robot that rests, turns once and rests, its sensors as fast as the IMU.

    `shake` is the share by which the turn rate varies at 1 to 8 Hz, as where wheels slip sideways;
    the body sways with it.
    """
    robot = usual_robot(rng)
    count = round(SECONDS * IMU_HZ)
    time = np.arange(count) / IMU_HZ
    turns = (time > REST) & (time < SECONDS - REST)
    rate = turns * math.tau / (SECONDS - 2.0 * REST) * rng.choice([-1.0, 1.0])
    jerks = smooth_wobble(rng, count, SECONDS, shake, (1.0, 8.0))[:, 0]
    yaw = np.cumsum(rate * (1.0 + jerks)) / IMU_HZ
    slope = slope_rpy(abs(rng.normal(0.0, 2.0)) * DEGREE, *rng.uniform(0.0, math.tau, 2))
    sway = smooth_wobble(rng, count, SECONDS, 0.5 * DEGREE, (0.2, 2.0))
    sway += smooth_wobble(rng, count, SECONDS, 0.3 * shake * DEGREE, (2.0, 8.0))
    standing = rotation_about(UP_ENU, -yaw) @ rotation_from_rpy(*slope).T
    motion = Motion(time, exp_rotations(sway * turns[:, None]) @ standing)
    knowledge = drawn_knowledge(rng, robot)
    return Scene(robot, motion, measure(robot, motion, rng, gyro=True)), knowledge


def collected_at(window: Window, field_hz: float) -> Window:
    """Return the window that a session collects from all IMU samples and a slower field."""
    streams, session = Streams(STREAMS.max_gap), Session(Limits(), Mounting(), 0.0)
    pairer, every = Pairer(streams), round(IMU_HZ / field_hz)
    assert window.angular_rate is not None
    rows = zip(
        BEGUN + window.time, window.field, window.specific_force, window.angular_rate, strict=True
    )
    for row, (stamp, field, force, rate) in enumerate(rows):
        streams.add_imu(ImuSample(stamp, tuple(force.tolist()), tuple(rate.tolist())))
        sample = FieldSample(stamp, tuple(field.tolist()))
        if row % every == 0 and streams.add_field(sample):
            pairer.offer(sample)
        for pair in pairer.take():
            session.add(pair, pair.field.stamp)
    return session.window()
