from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from simulated.turns import Trouble, measure, smooth_wobble, turn

from magcal_ros.core import Correction
from magcal_ros.core.geometry import STANDARD_GRAVITY, yaw_from_up_and_field
from magcal_ros.core.simulation import DEGREE, UP_ENU, Robot, heading_errors, trial_attitudes

QUIET = Robot(noise_field=0.0, noise_force=0.0, noise_rate=0.0)


def rng():
    return np.random.default_rng(0)


def test_a_level_turn_goes_counter_clockwise_through_every_heading():
    motion = turn(samples=8, start_rpy=(0.0, 0.0, 0.3))
    field = motion.attitude @ QUIET.field_enu
    yaw = yaw_from_up_and_field(motion.attitude @ UP_ENU, field)
    np.testing.assert_allclose(np.diff(np.unwrap(yaw)), math.pi / 4.0)
    assert yaw[0] == pytest.approx(0.3)


def test_at_rest_the_accelerometer_reads_one_g_upwards():
    window = measure(QUIET, turn(), rng())
    np.testing.assert_allclose(
        window.specific_force, np.tile([0, 0, STANDARD_GRAVITY], (500, 1)), atol=1e-12
    )


@pytest.mark.parametrize("arc", [6.0, -3.0])
def test_the_gyro_reads_the_rate_about_the_axis(arc):
    motion = turn(arc=arc, axis=[0.0, 0.6, 0.8], duration=10.0, start_rpy=(0.1, 0.2, 0.3))
    rate = measure(QUIET, motion, rng(), gyro=True).angular_rate
    np.testing.assert_allclose(
        rate[1:-1], np.tile([0, 0.06 * arc, 0.08 * arc], (498, 1)), atol=1e-9
    )


def test_the_true_correction_gives_the_true_field_and_heading():
    robot = replace(QUIET, soft_iron=np.diag([0.05, -0.02, 0.0]), yaw=0.1)
    motion = turn(start_rpy=(0.1, 0.2, 0.3))
    window = measure(robot, motion, rng())
    corrected = robot.true_correction.apply(window.field)
    np.testing.assert_allclose(corrected, motion.attitude @ robot.field_enu, atol=1e-18)
    np.testing.assert_allclose(heading_errors(robot.true_correction, robot), 0.0, atol=1e-12)


def test_uncorrected_hard_iron_gives_a_periodic_heading_error():
    robot = Robot(roll=0.0, pitch=0.0, hard_iron=[5e-6, 0.0, 0.0])
    worst = np.abs(heading_errors(Correction.identity(), robot)[:, 4]).max()
    assert worst == pytest.approx(math.asin(5e-6 / 25e-6), rel=0.05)


def test_yaw_of_the_installation_is_a_constant_heading_error():
    robot = Robot(roll=0.0, pitch=0.0, yaw=0.1, hard_iron=np.zeros(3))
    without = Correction(np.eye(3), np.zeros(3))
    np.testing.assert_allclose(np.abs(heading_errors(without, robot)[:, 4]), 0.1, atol=1e-12)


def test_noise_has_its_sigma():
    robot = Robot()
    motion = turn(samples=5000)
    noisy, clean = measure(robot, motion, rng()), measure(QUIET, motion, rng())
    assert np.std(noisy.field - clean.field) == pytest.approx(robot.noise_field, rel=0.03)
    force = noisy.specific_force - clean.specific_force
    assert np.std(force) == pytest.approx(robot.noise_force, rel=0.03)


def test_outliers_have_their_share():
    motion = turn(samples=5000)
    window = measure(QUIET, motion, rng(), trouble=Trouble(outliers=0.1))
    hit = np.abs(window.field - measure(QUIET, motion, rng()).field).max(axis=1) > 1e-12
    assert hit.mean() == pytest.approx(0.1, abs=0.02)


def test_a_disturbance_comes_and_goes_once():
    trouble = Trouble(disturbance=5e-6, disturbance_share=0.2)
    disturbed = measure(QUIET, turn(), rng(), trouble=trouble)
    size = np.linalg.norm(disturbed.field - measure(QUIET, turn(), rng()).field, axis=1)
    touched = np.flatnonzero(size > 1e-12)
    assert len(touched) == 100
    assert np.ptp(touched) == 99
    assert size.max() == pytest.approx(5e-6, rel=0.01)


def test_wobble_has_its_size_and_lies_across_the_axis():
    axis = np.array([0.0, 0.6, 0.8])
    drawn = np.concatenate(
        [smooth_wobble(np.random.default_rng(s), 500, 15.0, 0.1, axis=axis) for s in range(50)]
    )
    np.testing.assert_allclose(drawn @ axis, 0.0, atol=1e-12)
    assert np.sqrt((drawn**2).sum(axis=1).mean() / 2.0) == pytest.approx(0.1, rel=0.1)


def test_the_middle_trial_attitudes_are_level():
    attitudes = trial_attitudes(10.0 * DEGREE)
    np.testing.assert_allclose(attitudes[:, 4] @ UP_ENU, np.tile(UP_ENU, (24, 1)), atol=1e-15)
    tilt = np.degrees(np.arccos((attitudes @ UP_ENU)[..., 2]))
    assert tilt[:, 1].max() == pytest.approx(10.0)
