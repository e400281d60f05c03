"""A robot that rests, turns once and rests has not left its place, whatever its motors add."""

import math
from dataclasses import replace

import numpy as np
import pytest
from side_by_side import with_motors
from uneven_turns import ROBOT, collected, driven, evenly

from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.knowledge import Systematics
from magcal_ros.core.simulation.simulator import DEGREE, LEVEL_TILT, heading_errors


@pytest.mark.parametrize("by_rate", [False, True])
@pytest.mark.parametrize("size", [3e-6, 15e-6])
def test_the_heading_at_rest_is_right_and_the_motors_are_named(size, by_rate):
    motion, window = driven(evenly, ROBOT, 6.0)
    rate = motion.angular_rate[:, 2]
    shape = rate / np.abs(rate).max() if by_rate else (np.abs(rate) > 0.02).astype(float)
    field = window.field + size * np.outer(shape, [0.6, -0.8, 0.0])
    knowledge = replace(ROBOT.knowledge(1.5e-6, 1.0 * DEGREE), systematics=Systematics())
    outcome = calibrate(collected(replace(window, field=field)), knowledge)
    gap = heading_errors(outcome.estimate.correction, ROBOT)[:, LEVEL_TILT]
    assert math.sqrt(np.mean(gap**2)) < 0.5 * DEGREE
    assert Figure.HEADINGS_DRIVEN not in outcome.estimate.figures
    assert "between rest and turn the field changes" in outcome.verdict.summary


def test_a_drive_does_not_answer_for_a_turn_on_the_spot_whose_motors_switch():
    """The turn is refused; the drive was 17 degrees wrong, said 1.9 and was accepted."""
    scene, knowledge = with_motors("switching", 10e-6)(3000)
    outcome = calibrate(collected(scene.window), knowledge)
    assert not outcome.verdict.accepted
    assert Figure.HEADINGS_DRIVEN not in outcome.estimate.figures
