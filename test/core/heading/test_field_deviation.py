"""A field that contradicts the calibration makes the yaw as uncertain as it is wrong."""

import math
from dataclasses import replace

import numpy as np
import pytest
from sample_results import calibration

from magcal_ros.core import Compass, Correction
from magcal_ros.core.geometry import field_in_enu, rotation_from_rpy
from magcal_ros.core.heading import FieldDeviation
from magcal_ros.core.heading.disturbance import UNKNOWN_YAW

STRENGTH, DIP = 50e-6, 1.1
RIGHT = replace(calibration(Correction(np.eye(3), np.zeros(3))), strength=STRENGTH, inclination=DIP)


def drive(matrix, iron, noise=0.0, turns=3):
    """Return errors and added variances of the yaw under an edited calibration, over turns."""
    rng = np.random.default_rng(1)
    edited = replace(RIGHT, correction=Correction(np.array(matrix), np.array(iron)))
    compass, doubt = Compass(edited), FieldDeviation(edited)
    found = []
    for k in range(turns * 360):
        yaw = math.radians(k)
        to_body = rotation_from_rpy(0.0, 0.0, yaw).T
        raw = to_body @ field_in_enu(STRENGTH, DIP) + noise * rng.standard_normal(3)
        field, up = compass.correct(tuple(raw)), (0.0, 0.0, 1.0)
        heading = compass.heading(field, up, 1e-5)
        error = math.remainder(heading.yaw - yaw, math.tau)
        found.append((error, doubt.add(1.0 + 0.05 * k, field, up, 1e-5)))
    return np.array(found).T


@pytest.mark.parametrize("noise", [0.0, 0.3e-6])
def test_a_field_that_agrees_adds_nothing(noise):
    _, added = drive(np.eye(3), np.zeros(3), noise)
    assert np.sqrt(added.max()) < math.radians(0.5)
    assert np.median(added) < math.radians(0.05) ** 2


@pytest.mark.parametrize(
    ("matrix", "iron"),
    [
        (np.diag([1.0, 5.0, 1.0]), np.zeros(3)),
        (np.diag([0.2, 1.0, 1.0]), np.zeros(3)),
        (np.eye(3), [1e-3, 0.0, 0.0]),
        (np.eye(3), [0.0, 12e-6, 0.0]),
        (np.eye(3), [6e-6, 0.0, 0.0]),
    ],
)
def test_an_edited_calibration_has_no_small_sigma(matrix, iron):
    error, added = drive(matrix, iron)
    error, added = error[360:], added[360:]
    assert math.sqrt(np.mean(error**2)) > math.radians(10.0)
    assert np.mean(error**2 / added) < 2.0


def test_a_disturbed_place_is_forgotten_and_the_variance_is_bounded():
    doubt, up = FieldDeviation(RIGHT), (0.0, 0.0, 1.0)
    x, y, z = field_in_enu(STRENGTH, DIP)
    assert doubt.add(1.0, (x, 0.001 * y, 10.0 * z), up, 1e-5) == UNKNOWN_YAW
    for k in range(1000):
        added = doubt.add(2.0 + k, (x, y, z), up, 1e-5)
    assert math.sqrt(added) < math.radians(2.0)


def test_jumps_of_time_do_no_harm():
    doubt, up = FieldDeviation(RIGHT), (0.0, 0.0, 1.0)
    field = tuple(field_in_enu(STRENGTH, DIP).tolist())
    for stamp in (5.0, 18005.0, 6.0, 6.0, 1e300, 7.0):
        assert doubt.add(stamp, field, up, 1e-5) == 0.0
