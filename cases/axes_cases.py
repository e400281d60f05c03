"""Robots with correct and with wrong axes of the magnetometer, drawn at random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from simulated.turns import Motion, Trouble, measure, slope_rpy, smooth_wobble

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import exp_rotation, rotation_from_rpy, rpy_from_rotation
from magcal_ros.core.knowledge import Knowledge, Mounting
from magcal_ros.core.samples.window import Window
from magcal_ros.core.simulation import DEGREE, Robot

MOTIONS = ("level", "wobbling", "lift")
SAMPLES, SECONDS = 600, 25.0


def movement(rng: np.random.Generator, kind: str) -> Motion:
    """Turn a little more than once either way, and lift the nose where asked for."""
    time = np.linspace(0.0, SECONDS, SAMPLES)
    yaw = rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 1.3) * 2.0 * np.pi * time / SECONDS
    lift = np.sin(np.pi * np.clip((time - 8.0) / 10.0, 0.0, 1.0)) ** 2
    pitch = -20.0 * DEGREE * lift if kind == "lift" else np.zeros(SAMPLES)
    sway = np.zeros((SAMPLES, 2))
    if kind != "level":
        sway = smooth_wobble(rng, SAMPLES, SECONDS, rng.uniform(0.1, 2.0) * DEGREE)[:, :2]
    slope = rng.uniform(0.0, 10.0) * DEGREE if kind == "slope" else 0.0
    rows = zip(sway, pitch, yaw, strict=True)
    attitude = [
        (rotation_from_rpy(*slope_rpy(slope, 0.4, y)) @ rotation_from_rpy(r, p + q, 0.0)).T
        for (r, q), p, y in rows
    ]
    return Motion(time, np.array(attitude))


def cheap_robot(rng: np.random.Generator, axes: FloatArray) -> Robot:
    """Draw a robot whose magnetometer has these axes, up to 8° off."""
    strength = rng.uniform(25e-6, 60e-6)
    dip = rng.choice([-1.0, 1.0]) * rng.uniform(20.0, 70.0) * DEGREE
    off = exp_rotation(_direction(rng) * rng.uniform(0.0, 8.0) * DEGREE)
    roll, pitch, yaw = rpy_from_rotation(off)
    return Robot(
        strength=strength,
        inclination=dip,
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        hard_iron=_direction(rng) * rng.uniform(0.0, 1.0) * strength,
        mounting=Mounting(pose=axes.T),
        noise_field=rng.uniform(0.2e-6, 1e-6),
        noise_rate=0.3 * DEGREE,
        gyro_bias=rng.uniform(-3.0, 3.0, 3) * DEGREE,
    )


def wrong_case(axes: FloatArray, rng: np.random.Generator, kind: str) -> tuple[Window, Knowledge]:
    """Return the samples of a magnetometer with these axes, and the prior knowledge."""
    robot = cheap_robot(rng, axes)
    window = measure(robot, movement(rng, kind), rng, gyro=True)
    return window, Knowledge(robot.knowledge(2e-6, 2.0 * DEGREE).reference)


def good_case(rng: np.random.Generator) -> tuple[Window, Knowledge]:
    """Return a turn of good sensors with disturbances."""
    iron = rng.uniform(-0.1, 0.1, (3, 3)) * rng.uniform(0.0, 1.0)
    robot = replace(cheap_robot(rng, np.eye(3)), soft_iron=0.5 * (iron + iron.T))
    trouble = Trouble(
        outliers=float(rng.choice([0.0, 0.02])),
        disturbance=rng.choice([0.0, 0.1, 0.3]) * robot.strength,
        vibration=float(rng.choice([0.0, 0.5])),
    )
    motion = movement(rng, str(rng.choice([*MOTIONS, "slope"])))
    window = measure(robot, motion, rng, gyro=True, trouble=trouble)
    assert window.angular_rate is not None
    acceleration = np.outer(window.angular_rate[:, 2] ** 2, [-rng.uniform(0.0, 0.3), 0.0, 0.0])
    acceleration[:, 1] += window.angular_rate[:, 2] * rng.uniform(0.0, 5.0)
    accelerated = Window(
        window.time, window.field, window.specific_force + acceleration, window.angular_rate
    )
    known = robot.knowledge(2e-6, 2.0 * DEGREE).reference
    return accelerated, Knowledge(known) if rng.random() < 0.5 else Knowledge()


def _direction(rng: np.random.Generator) -> FloatArray:
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))
