"""Calibrations and attempts to report on, from simulated turns."""

import math
from dataclasses import replace
from datetime import datetime, timezone
from functools import cache

import numpy as np
from simulated.turns import Trouble, measure, turn

from magcal_ros.core import METHODS, calibrate
from magcal_ros.core.simulation import Robot
from magcal_ros.report import Subject

CREATED = datetime(2024, 5, 31, 14, 3, 7, tzinfo=timezone.utc)
METHOD = METHODS[0]
ROBOT = Robot()


def known(robot, *sigmas):
    """The prior knowledge of a robot, without constant sensor errors."""
    return replace(robot.knowledge(*sigmas), exact_sensors=False)


def subject_of(window, knowledge, outcome=None, **changes):
    if outcome is None:
        outcome = calibrate(window, knowledge, METHOD)
    values = {"source": "imu/data_raw, imu/mag", "created": CREATED, "method": METHOD}
    return Subject(window, knowledge, outcome, **(values | changes))


@cache
def good(gyro=True):
    """A full turn of a robot that agrees with the model."""
    window = measure(ROBOT, turn(), np.random.default_rng(1), gyro=gyro)
    return subject_of(window, known(ROBOT, 1e-6, math.radians(1.0)))


@cache
def troubled():
    """A long turn about a tilted axis with soft iron and outliers: every part of a report."""
    robot = Robot(soft_iron=np.diag([0.1, -0.1, 0.0]))
    motion = turn(samples=1000, axis=np.array([0.0, 0.3, 0.9]))
    rng = np.random.default_rng(2)
    window = measure(robot, motion, rng, gyro=True, trouble=Trouble(outliers=0.1))
    return subject_of(window, known(robot, 1e-6, math.radians(1.0)))


@cache
def refused():
    """A robot at rest."""
    window = measure(ROBOT, turn(arc=0.05), np.random.default_rng(3), gyro=True)
    return subject_of(window, ROBOT.knowledge())
