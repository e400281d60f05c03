"""Simulated turns on the level and on slopes."""

import math
from dataclasses import replace

import numpy as np
from simulated.turns import measure, slope_rpy, turn

from magcal_ros.core.simulation import Robot

TILT = math.radians(10.0)
EAST, NORTH, WEST, SOUTH = (k * math.pi / 2 for k in range(4))
LEVEL = None

ROBOT = replace(
    Robot(),
    yaw=math.radians(5.0),
    hard_iron=np.array([30e-6, -20e-6, 25e-6]),
)
KNOWN = ROBOT.knowledge(1.5e-6, math.radians(1.0))
UNKNOWN = ROBOT.knowledge(math.inf, math.inf)


def motion_on(slope, heading=0.0, **options):
    tilt, azimuth = (0.0, 0.0) if slope is LEVEL else (TILT, slope)
    return turn(start_rpy=slope_rpy(tilt, azimuth, heading), **options)


def window_on(slope, rng, robot=ROBOT, heading=None, gyro=False, **options):
    heading = rng.uniform(0.0, math.tau) if heading is None else heading
    return measure(robot, motion_on(slope, heading, **options), rng, gyro=gyro)


def windows_on(slopes, seed, robot=ROBOT, **options):
    rng = np.random.default_rng(seed)
    return [window_on(slope, rng, robot, **options) for slope in slopes]
