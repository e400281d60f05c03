import math
from dataclasses import replace

import numpy as np
import pytest
from slope_turns import EAST, LEVEL, NORTH, ROBOT, WEST, windows_on

from magcal_ros.core.estimation.averaging import prepare
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.estimation.sphere import sphere_guess
from magcal_ros.core.knowledge import Knowledge

SCALE = 50e-6
BLANK = Globals(np.eye(3), np.eye(3), 0.0, 0.0, np.zeros(3), 1.0, 1.0)


def samples_on(slopes, robot=ROBOT):
    windows = windows_on(slopes, 1, robot)
    return [prepare(w.field, w.specific_force, Knowledge(), 800).all for w in windows]


@pytest.mark.parametrize("yaw_deg", [5.0, -40.0, 120.0])
def test_circles_on_different_tilts_give_a_guess_without_any_belief(yaw_deg):
    robot = replace(ROBOT, yaw=math.radians(yaw_deg), noise_field=0.05e-6, noise_force=0.01)
    guess = sphere_guess(samples_on([LEVEL, EAST, NORTH, WEST], robot), BLANK)
    np.testing.assert_allclose(guess.hard_iron, robot.hard_iron / SCALE, atol=0.03)
    assert guess.strength == pytest.approx(1.0, abs=0.03)
    assert math.degrees(guess.yaw) == pytest.approx(yaw_deg, abs=3.0)
    assert guess.inclination == pytest.approx(robot.inclination, abs=0.05)


def test_one_plane_leaves_hard_iron_and_yaw_as_they_are():
    guess = sphere_guess(samples_on([LEVEL, LEVEL]), replace(BLANK, hard_iron=np.full(3, 0.3)))
    np.testing.assert_allclose(guess.hard_iron, 0.3)
    assert abs(guess.yaw) < 0.2
