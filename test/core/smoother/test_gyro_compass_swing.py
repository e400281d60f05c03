"""The deviation of compass from gyro: small for good turns, large in a distorted room."""

import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from simulated.turns import measure, turn

from magcal_ros.core.geometry import body_from_enu, rotation_from_rpy
from magcal_ros.core.methods.smoother import fit
from magcal_ros.core.simulation import DEGREE, Robot
from magcal_ros.core.smoother import gyro_compass_swing


def known(robot):
    return replace(robot.knowledge(1.5e-6, DEGREE), exact_sensors=False)


@pytest.mark.parametrize(
    ("arc", "samples"), [(360.0, 60), pytest.param(180.0, 500, marks=pytest.mark.nightly)]
)
def test_a_good_turn_has_a_small_deviation(arc, samples):
    robot = Robot()
    motion = turn(arc=arc * DEGREE, samples=samples)
    estimate = fit(
        measure(robot, motion, np.random.default_rng(1), gyro=True),
        known(robot),
    )
    assert estimate.figures["gyro_compass_rms"] < 1.0 * DEGREE


@pytest.mark.parametrize("phase", first_of([0.0, 1.0, 2.0]))
@pytest.mark.parametrize("swing_deg", first_of([27.0, 19.0]))
def test_the_deviation_in_a_distorted_room_has_the_true_size(phase, swing_deg):
    robot, motion, rng = Robot(), turn(), np.random.default_rng(2)
    window = measure(robot, motion, rng, gyro=True)
    swing = swing_deg * DEGREE * np.sin(np.linspace(0.0, 2.0 * math.pi, len(window)) + phase)
    turned = np.stack([rotation_from_rpy(0.0, 0.0, angle) @ robot.field_enu for angle in swing])
    body = np.einsum("nij,nj->ni", motion.attitude, turned)
    measured = body + robot.noise_field * rng.standard_normal(body.shape)
    attitude = body_from_enu(motion.attitude[:, :, 2], measured)
    relative = motion.attitude @ motion.attitude[0].T
    found = gyro_compass_swing(relative, attitude, window.time).rms
    assert found == pytest.approx(swing_deg * DEGREE / math.sqrt(2.0), rel=0.2)
