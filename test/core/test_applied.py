"""A calibration on samples that it was not made from."""

import dataclasses
import math

import numpy as np
import pytest

from magcal_ros.core.applied import applied, expected_field
from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.holds import check, up_of
from magcal_ros.core.simulator import Robot, measure, turn
from magcal_ros.core.verdict import Grade

ROBOT = Robot()


def window_of(robot, seed):
    return measure(robot, turn(arc=6.2), np.random.default_rng(seed), gyro=True)


@pytest.fixture(scope="module")
def calibration():
    return calibrate(window_of(ROBOT, 1), ROBOT.knowledge()).calibration


def outcome_on(robot, calibration):
    window = window_of(robot, 2)
    found = check(window, calibration)
    return applied(window, up_of(window), 6.2, calibration, found)


def test_the_residual_is_the_sensors_noise_while_the_calibration_holds(calibration):
    outcome = outcome_on(ROBOT, calibration)
    rms = float(np.sqrt(np.mean(outcome.estimate.residual**2)))
    assert rms == pytest.approx(0.5e-6, rel=0.35)
    assert outcome.verdict.accepted
    assert outcome.verdict.summary.startswith("The calibration holds")


def test_a_hard_iron_that_moved_is_in_the_residual_and_refused(calibration):
    moved = ROBOT.hard_iron + np.array([6e-6, 0.0, 0.0])
    outcome = outcome_on(dataclasses.replace(ROBOT, hard_iron=moved), calibration)
    assert float(np.sqrt(np.mean(outcome.estimate.residual**2))) > 1.2e-6
    assert outcome.verdict.quality is Grade.REFUSED
    assert outcome.verdict.confidence is Grade.GOOD


def test_the_expected_field_has_the_strength_the_dip_and_the_heading_of_the_measured():
    up = np.tile([0.0, 0.0, 1.0], (5, 1))
    angles = np.linspace(0.0, 5.0, 5)
    field = np.stack([np.cos(angles), np.sin(angles), np.full(5, -3.0)], axis=-1)
    expected = expected_field(field, up, 2.0, math.radians(60.0))
    assert np.allclose(np.linalg.norm(expected, axis=1), 2.0)
    assert np.allclose(expected[:, 2], -2.0 * math.sin(math.radians(60.0)))
    assert np.allclose(
        np.arctan2(expected[:, 1], expected[:, 0]) - angles,
        np.round((np.arctan2(expected[:, 1], expected[:, 0]) - angles) / math.tau) * math.tau,
    )
