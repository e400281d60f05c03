"""Turns to try the design tip on, and how far its answers are off."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated.turns import measure, turn

from magcal_ros.core import Refusal
from magcal_ros.core.methods.design_tip import fit
from magcal_ros.core.simulation import DEGREE, Robot

QUIET = Robot(noise_field=0.0, noise_force=0.0)


def level_turn(robot=QUIET, seed=0, **motion):
    rng = np.random.default_rng(seed)
    motion.setdefault("start_rpy", (0.0, 0.0, rng.uniform(0.0, 2.0 * math.pi)))
    return measure(robot, turn(**motion), rng)


def ramp_turn(robot=QUIET, seed=0, ramp=10.0 * DEGREE, **motion):
    rng = np.random.default_rng(seed)
    azimuth, yaw = rng.uniform(0.0, 2.0 * math.pi, 2)
    start = (ramp * math.cos(azimuth), ramp * math.sin(azimuth), yaw)
    return measure(robot, turn(start_rpy=start, **motion), rng)


def rms_deg(errors):
    return float(np.degrees(np.sqrt(np.mean(np.square(errors)))))


def distance(estimate, robot):
    """Largest relative difference from the true twelve numbers."""
    scale = np.r_[np.ones(9), np.full(3, robot.strength)]
    difference = estimate.correction.parameters - robot.true_correction.parameters
    return np.abs(difference / scale).max()


def rms_of(values):
    return float(np.sqrt(np.mean(np.square(values))))


def refusal(window, knowledge):
    with pytest.raises(Refusal) as caught:
        fit(window, knowledge)
    return caught.value
