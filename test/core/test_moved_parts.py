"""A part of the robot is moved during a turn: its field changes in permanent steps."""

import math
from dataclasses import replace

import numpy as np
import pytest
from uneven_turns import ROBOT, collected, driven, evenly

from magcal_ros.core import calibrate
from magcal_ros.core.calibration import calibration_sigma
from magcal_ros.core.simulation import DEGREE, LEVEL_TILT, heading_errors

pytestmark = pytest.mark.usefixtures("right_axes")

STEP = np.array([4.0, -3.0, 5.0]) * 1e-6


def turned(change):
    """The RMS heading error of a turn, and its sigma; `change` is the share of `STEP` by time."""
    _, window = driven(evenly, ROBOT, 3.0)
    moved = replace(window, field=window.field + np.outer(change(window.time), STEP))
    knowledge = replace(ROBOT.knowledge(1.5e-6, 1.0 * DEGREE), exact_sensors=False)
    outcome = calibrate(collected(moved), knowledge)
    gap = heading_errors(outcome.estimate.correction, ROBOT)[:, LEVEL_TILT]
    return math.sqrt(np.mean(gap**2)), calibration_sigma(outcome.estimate, 0.0)


@pytest.mark.parametrize(
    ("closes", "most"),
    [(13.0, 0.5 * DEGREE), pytest.param(99.0, 2.0 * DEGREE, marks=pytest.mark.nightly)],
)
def test_an_opened_lid_is_not_taken_for_soft_iron(closes, most):
    def lid(time):
        return np.clip((time - 8.0) / 0.6, 0.0, 1.0) - np.clip((time - closes) / 0.6, 0.0, 1.0)

    error, sigma = turned(lid)
    assert error < most
    assert error < 2.0 * sigma
