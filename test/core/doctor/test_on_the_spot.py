"""A motor field is reported only for turns on the spot, and not for another place."""

import math

import numpy as np
import pytest
from long_form import first_of

from magcal_ros.core.doctor import examine
from magcal_ros.core.geometry import chained, exp_rotations
from magcal_ros.core.samples import SensorLog

RATE, STEP = 0.36, 1.0 / 30.0


def log_of(radius, added, sway=0.0):
    """Rest, turn at `radius` metres from the axis, and rest; `added` is there while it turns.

    The body sways by so many radians.
    """
    rng = np.random.default_rng(4)
    time = np.arange(-6.0, 31.0, STEP)
    moves = np.clip(np.minimum(time, 25.0 - time) / 2.0, 0.0, 1.0)
    rate = RATE * moves
    turned = exp_rotations(-np.outer(np.cumsum(rate) * STEP, [0.0, 0.0, 1.0]))
    field = turned @ np.array([0.0, 25e-6, -43e-6]) + np.array([30e-6, -20e-6, 25e-6])
    field += np.outer(moves > 0.0, added) + 0.3e-6 * rng.normal(size=(len(time), 3))
    force = np.array([0.3, -0.2, 9.8]) + 0.05 * rng.normal(size=field.shape)
    force[:, 0] += radius * np.gradient(rate, STEP)
    force[:, 1] += radius * rate**2
    rates = np.outer(rate, [0.0, 0.0, 1.0]) + 2e-3 * rng.normal(size=field.shape)
    pace = math.tau * np.array([1.1, 0.8, 0.0])
    leans = exp_rotations(-sway * np.sin(np.outer(time, pace)))
    force, field, rates = ((leans @ each[:, :, None])[:, :, 0] for each in (force, field, rates))
    rates += sway * pace * np.cos(np.outer(time, pace))
    return SensorLog(time, force, rates, time, field)


@pytest.mark.nightly
@pytest.mark.parametrize("case", first_of([(0.6, True), (11.0, False), (0.0, True)]))
def test_a_drive_before_a_circle_is_not_taken_for_motors(case):
    radius, is_named = case
    (line,) = (
        f for f in examine(log_of(radius, [3e-6, -2e-6, 4e-6])).findings if f.key == "motors"
    )
    assert line.is_wrong == is_named
    assert ("the robot drove while it turned" in line.evidence) != is_named


def test_a_circle_without_a_rest_is_answered_by_a_turn_on_the_spot():
    log = log_of(11.0, [0.0, 0.0, 0.0], sway=0.01)
    moves = (log.imu_time > 3.0) & (log.imu_time < 22.0)
    stamps = log.imu_time[moves]
    circle = SensorLog(stamps, log.force[moves], log.rate[moves], stamps, log.field[moves])
    (line,) = (f for f in examine(circle).findings if f.key == "motors")
    assert "the robot drove while it turned" in line.evidence


def test_a_hand_held_swing_gives_no_fault_of_axes_or_unit():
    rng = np.random.default_rng(8)
    time = np.arange(0.0, 30.0, 0.01)
    moves = ((time > 3.0) & (time < 27.0))[:, None]
    swing = np.column_stack([np.sin(0.7 * time), np.sin(1.1 * time), np.sin(0.5 * time)])
    rate = 12.0 * moves * swing
    body = chained(exp_rotations(-0.01 * rate[1:])[None])[0]
    arm = np.array([0.15, 0.0, 0.0])
    centripetal = np.cross(rate, np.cross(rate, arm))
    force = (
        body @ np.array([0.0, 0.0, 9.81]) + centripetal + 0.05 * rng.normal(size=centripetal.shape)
    )
    field = body @ np.array([0.0, 20e-6, -43e-6]) + 0.3e-6 * rng.normal(size=centripetal.shape)
    log = SensorLog(time, force, rate + 2e-3 * rng.normal(size=centripetal.shape), time, field)
    lines = [f for f in examine(log).findings if f.name.startswith("accelerometer: u")]
    assert [f.key for f in lines] == ["force_unit", "gravity_sign"]
    assert not any(f.is_wrong for f in lines)
