"""Kinds of turns for `realistic.py`: there and back, with stops, on uneven ground.

None of them is a fault, and a verdict has to bear them all.
"""

from __future__ import annotations

import math

import numpy as np
from simulated.turns import Motion, smooth_wobble

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import exp_rotations, minimal_rotation, rotation_about
from magcal_ros.core.simulation import DEGREE, UP_ENU, Robot

KINDS = ("even", "uneven", "there and back", "stops", "fast", "slope", "bent ground", "steep field")


def drawn_robot(rng: np.random.Generator, kind: str) -> Robot:
    """Draw a robot anywhere between the equator and 72° of dip, or where the field is steep."""
    dip = rng.uniform(54.0, 78.0) if kind == "steep field" else rng.uniform(0.0, 72.0)
    return Robot(
        strength=rng.uniform(30e-6, 60e-6),
        inclination=rng.choice([-1.0, 1.0]) * dip * DEGREE,
        roll=rng.normal(0.0, 4.0) * DEGREE,
        pitch=rng.normal(0.0, 4.0) * DEGREE,
        hard_iron=rng.normal(0.0, 20e-6, 3),
        noise_field=math.exp(rng.uniform(math.log(0.1e-6), math.log(1e-6))),
        noise_force=math.exp(rng.uniform(math.log(0.02), math.log(0.2))),
        noise_rate=2e-3,
        gyro_bias=rng.normal(0.0, 0.003, 3),
    )


def drawn_motion(rng: np.random.Generator, kind: str) -> Motion:
    """Draw a full turn of 10 to 40 s, 200 to 2500 samples, on ground that is not quite level."""
    samples = round(math.exp(rng.uniform(math.log(200.0), math.log(2500.0))))
    seconds = rng.uniform(10.0, 40.0)
    share = np.arange(samples) / samples
    yaw = rng.choice([-1.0, 1.0]) * _turned(rng, kind, share) + rng.uniform(0.0, math.tau)
    tilt = rng.uniform(5.0, 15.0) if kind == "slope" else abs(rng.normal(0.0, 3.0))
    azimuth = rng.uniform(0.0, math.tau)
    rise = tilt * DEGREE * np.array([math.cos(azimuth), math.sin(azimuth)])
    leaning = np.tile(-rise, (samples, 1))
    if kind == "bent ground":
        for order in (1, 2, 3):
            size = rng.normal(0.0, 3.0 / order, (2, 2)) * DEGREE
            leaning += np.column_stack([np.cos(order * yaw), np.sin(order * yaw)]) @ size
    sway = smooth_wobble(
        rng,
        samples,
        seconds,
        rng.uniform(0.0, 1.5) * DEGREE,
        (0.1, min(2.0, samples / seconds / 15)),
    )
    level = rotation_about(UP_ENU, yaw)
    upright = np.column_stack([leaning, np.sqrt(1.0 - np.sum(leaning**2, axis=1))])
    standing = np.array(
        [(minimal_rotation(UP_ENU, up) @ turn).T for up, turn in zip(upright, level, strict=True)]
    )
    return Motion(seconds * share, exp_rotations(sway) @ standing)


def _turned(rng: np.random.Generator, kind: str, share: FloatArray) -> FloatArray:
    arc = rng.uniform(1.0, 1.2) * math.tau
    if kind == "there and back":
        return rng.uniform(0.5, 1.2) * math.pi * (1.0 - np.cos(math.tau * share))
    if kind == "uneven":
        return arc * share + 0.8 * np.sin(3.0 * math.tau * share + rng.uniform(0.0, math.tau))
    if kind == "stops":
        legs = 8.0 * share
        return arc / 8.0 * (np.floor(legs) + np.clip(2.0 * (legs % 1.0), 0.0, 1.0))
    return (rng.uniform(2.0, 6.0) * math.tau if kind == "fast" else arc) * share
