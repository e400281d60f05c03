"""Sensors tumbled through all orientations, and windows of what they measure."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation
from simulated.turns import Motion, measure

from magcal_ros.core import Window
from magcal_ros.core.simulation import Robot

SQUARE = Robot(roll=0.0, pitch=0.0)
QUIET = Robot(roll=0.0, pitch=0.0, noise_field=0.0, noise_force=0.0)


def tumbling(rng, samples=800):
    """Attitudes that cover the sphere evenly, in no order."""
    drawn = Rotation.from_quat(rng.standard_normal((samples, 4)))
    return Motion(np.linspace(0.0, 60.0, samples), drawn.as_matrix())


def hand_tumbling(rng, samples=800, duration=60.0):
    """A smooth tumbling as a hand does it, of a few rad/s about wandering axes."""
    time = np.linspace(0.0, duration, samples)
    frequency, phase = rng.uniform(0.05, 0.2, (3, 3)), rng.uniform(0.0, math.tau, (3, 3))
    rate = np.sin(math.tau * frequency * time[:, None, None] + phase).sum(axis=2)
    steps = Rotation.from_rotvec(rate * duration / samples)
    attitude = Rotation.from_quat(rng.standard_normal(4))
    attitudes = []
    for step in steps:
        attitude = step * attitude
        attitudes.append(attitude.as_matrix())
    return Motion(time, np.array(attitudes))


def tumble(robot=SQUARE, seed=0, motion=tumbling, **arguments):
    rng = np.random.default_rng(seed)
    return measure(robot, motion(rng, **arguments), rng)


def with_fields(window, field):
    return Window(window.time, field, window.specific_force)


def pole_window(robot=QUIET):
    """Noise-free samples in which every sensor axis points along the field and against it."""
    window = tumble(robot)
    field = window.field.copy()
    gains = np.linalg.inv(robot.true_correction.matrix)
    poles = robot.strength * np.vstack([np.eye(3), -np.eye(3)])
    field[:6] = poles @ gains.T + robot.hard_iron
    return with_fields(window, field)
