"""Long windows of weak motion: an underwater robot that sways, as MAGYC's benchmark has it.

Rodríguez-Martínez et al., 2024: one µT and .01 rad/s of noise at 10 Hz, a biased gyro, and the soft
iron of their paper.
"""

from __future__ import annotations

import math

import numpy as np
from simulated.turns import Motion

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.core.geometry.rotations import rotation_about
from magcal_ros.core.samples.window import Window
from magcal_ros.core.simulation import UP_ENU, Robot

ALONG_X: FloatArray = np.array([1.0, 0.0, 0.0])
ALONG_Y: FloatArray = np.array([0.0, 1.0, 0.0])
PAPER_SOFT_IRON: FloatArray = np.array(
    [[0.10, 0.10, 0.04], [0.10, -0.12, 0.02], [0.04, 0.02, 0.22]]
)
RATE = 10.0


def swaying_robot(soft_iron: FloatArray) -> Robot:
    """Return the robot; `soft_iron` (3, 3) is E."""
    return Robot(
        strength=47.3e-6,
        inclination=math.radians(60.5),
        roll=0.0,
        pitch=0.0,
        hard_iron=np.array([2e-6, 12e-6, 9e-6]),
        soft_iron=soft_iron,
        noise_field=1e-6,
        noise_force=0.01 * STANDARD_GRAVITY,
        noise_rate=0.01,
        gyro_bias=np.array([0.004, -0.005, 0.002]),
    )


def swaying(seconds: float, *, turns: bool) -> Motion:
    """Sway on the spot.

    Parameters
    ----------
    seconds : float
        How long.
    turns : bool
        Two turns forth and back every two minutes with 5° of tilt; otherwise yaw by ±90° and pitch
        by ±45°.
    """
    time = np.arange(0.0, seconds, 1.0 / RATE)
    phase = math.tau * time
    tilt = math.radians(5.0)
    if turns:
        yaw, pitch = math.tau * (1.0 - np.cos(phase / 120.0)), tilt * np.sin(phase / 23.0)
    else:
        yaw = 0.5 * math.pi * np.sin(phase / 60.0)
        pitch = 0.25 * math.pi * np.sin(phase / 23.0)
    roll = tilt * np.sin(phase / 17.0)
    attitude = (
        rotation_about(ALONG_X, -roll)
        @ rotation_about(ALONG_Y, -pitch)
        @ rotation_about(UP_ENU, -yaw)
    )
    return Motion(time + 1000.0, attitude)


def swaying_window(robot: Robot, motion: Motion, rng: np.random.Generator) -> Window:
    """Return the samples of the motion."""
    shape = (len(motion.time), 3)
    field, force, rate = rng.standard_normal((3, *shape))
    return Window(
        motion.time,
        robot.raw_field(motion.attitude @ robot.field_enu) + robot.noise_field * field,
        STANDARD_GRAVITY * motion.attitude[:, :, 2] + robot.noise_force * force,
        motion.angular_rate + robot.gyro_bias + robot.noise_rate * rate,
    )
