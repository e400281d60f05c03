"""With the true numbers given, attitudes and axes are those that were turned."""

import math
from dataclasses import replace

import numpy as np
import pytest
from slope_turns import EAST, LEVEL, NORTH, ROBOT, motion_on

from magcal_ros.core.estimation.averaging import prepare
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.estimation.seating import seated
from magcal_ros.core.geometry.rotations import rotation_angle
from magcal_ros.core.simulation.simulator import DEGREE, measure

QUIET = replace(ROBOT, noise_field=0.0, noise_force=0.0, yaw=0.0)


def true_numbers():
    return Globals(
        np.eye(3),
        np.eye(3),
        QUIET.roll,
        QUIET.pitch,
        QUIET.hard_iron / QUIET.strength,
        1.0,
        QUIET.inclination,
    )


def turned(slope, arc_deg):
    motion = motion_on(slope, heading=0.4, arc=arc_deg * DEGREE, samples=300)
    window = measure(QUIET, motion, np.random.default_rng(1))
    return prepare(window.field, window.specific_force, QUIET.knowledge(), 300).all


@pytest.mark.parametrize("slope", [LEVEL, EAST, NORTH])
@pytest.mark.parametrize("arc_deg", [90.0, 200.0, 360.0])
def test_the_axis_is_found_and_nothing_leans(slope, arc_deg):
    state = seated(true_numbers(), turned(slope, arc_deg), np.ones(300, dtype=bool))
    # The turn's lean is zero where both axes are the true ones.
    assert np.degrees(np.abs(state.lean[:, :2]).max()) < 1e-5
    angles = np.unwrap(np.arctan2(state.attitude[:, 1, 0], state.attitude[:, 0, 0]))
    assert abs(angles[-1] - angles[0]) == pytest.approx(arc_deg * DEGREE, rel=0.02)


def test_outliers_do_not_move_the_axis_but_have_attitudes():
    samples = turned(EAST, 360.0)
    field = samples.field.copy()
    field[:30] += 0.7
    inliers = np.arange(300) >= 30
    clean = seated(true_numbers(), samples, np.ones(300, dtype=bool))
    bent = seated(true_numbers(), replace(samples, field=field), inliers)
    gap = rotation_angle(bent.shared.world_axis @ clean.shared.world_axis.T)
    assert math.degrees(gap) < 0.5
    assert np.isfinite(bent.attitude).all()


def test_with_too_few_inliers_all_samples_show_the_axis():
    samples = turned(EAST, 360.0)
    all_of_them = seated(true_numbers(), samples, np.ones(300, dtype=bool))
    none = seated(true_numbers(), samples, np.zeros(300, dtype=bool))
    np.testing.assert_array_equal(none.attitude, all_of_them.attitude)
