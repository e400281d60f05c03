"""Circles driven at an uneven rate, with centripetal acceleration and a gyro bias."""

import math
from dataclasses import replace

import numpy as np
from simulated.turns import Motion, measure

from magcal_ros.core import Window
from magcal_ros.core.calibration import predicted_heading_sigma
from magcal_ros.core.geometry import rotation_about
from magcal_ros.core.methods.smoother import fit
from magcal_ros.core.simulation import DEGREE, LEVEL_TILT, Robot, heading_errors

UP = np.array([0.0, 0.0, 1.0])


def circles(bias=(0.0, 0.0, 0.0), radius=0.0, unevenness=0.4, seed=1):
    """Two circles at an uneven rate; the acceleration is that of a circle of this radius."""
    time = np.arange(0.0, 40.0, 0.05)
    rate = math.tau / 20.0 * (1.0 + unevenness * np.sin(math.tau * time / 13.0))
    yaw = np.cumsum(rate) * 0.05
    robot = Robot(gyro_bias=np.array(bias) * DEGREE, noise_field=0.3e-6, noise_force=0.05)
    motion = Motion(time, rotation_about(UP, -yaw))
    window = measure(robot, motion, np.random.default_rng(seed), gyro=True)
    acceleration = np.zeros((len(time), 3))
    acceleration[:, 1] = rate**2 * radius
    return robot, Window(
        time, window.field, window.specific_force + acceleration, window.angular_rate
    )


def known(robot):
    return replace(robot.knowledge(1.5e-6, 1.0 * DEGREE), exact_sensors=False)


def error_and_sigma(robot, window):
    estimate = fit(window, known(robot))
    gap = heading_errors(estimate.correction, robot)[:, LEVEL_TILT]
    return math.sqrt(np.mean(gap**2)), predicted_heading_sigma(estimate, 0.0), estimate
