import dataclasses
import math

import numpy as np
import pytest
from drives import ROBOT

from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.holds import BOUNDS, NO_GYRO, State, check
from magcal_ros.core.simulator import Robot, measure, smooth_wobble, turn


def window(robot=ROBOT, seed=1, gyro=True, samples=700, duration=14.0, **motion):
    moved = turn(samples=samples, duration=duration, **motion)
    return measure(robot, moved, np.random.default_rng(seed), gyro=gyro)


@pytest.fixture(scope="module")
def calibration():
    return calibrate(window(), ROBOT.knowledge()).calibration


def moved(x=0.0, y=0.0, z=0.0, **changes):
    shift = np.array([x, y, z]) * 1e-6
    return dataclasses.replace(ROBOT, hard_iron=ROBOT.hard_iron + shift, **changes)


def figures(result):
    return {finding.figure: finding for finding in result.findings}


@pytest.mark.parametrize("gyro", [True, False])
@pytest.mark.parametrize("arc", [math.tau, -math.tau, 4.0])
def test_a_good_one_holds_on_a_fresh_turn(calibration, gyro, arc):
    result = check(window(seed=2, gyro=gyro, arc=arc), calibration)
    assert result.state is State.HOLDS, result.summary
    assert result.summary.startswith("The calibration holds: ")
    assert ("gyro_compass_rms" in figures(result)) == gyro
    assert (NO_GYRO in result.not_shown) == (not gyro)


@pytest.mark.parametrize("gyro", [True, False])
@pytest.mark.parametrize("shift", [(5, 0), (0, -5), (-3.5, 3.5)])
def test_hard_iron_that_moved_by_5_ut_makes_it_stale(calibration, gyro, shift):
    result = check(window(moved(*shift), seed=3, gyro=gyro), calibration)
    assert result.state is State.STALE
    found = figures(result)
    # 5 µT across a level field of 25 µT swing the heading by 11.5° at most, 8.1° rms.
    assert found["heading_swing"].after == pytest.approx(8.1, abs=0.8)
    assert "calibrate again" in result.summary
    if gyro:
        assert found["gyro_compass_rms"].after == pytest.approx(8.1, abs=1.0)


@pytest.mark.parametrize("gyro", [True, False])
def test_it_swings_less_after_than_before(calibration, gyro):
    for finding in check(window(seed=4, gyro=gyro), calibration).findings:
        assert finding.after < 0.5 * finding.before, finding


def test_hard_iron_along_the_axis_is_doubtful_and_no_heading_error(calibration):
    result = check(window(moved(z=5.0), seed=5), calibration)
    assert result.state is State.DOUBTFUL
    assert figures(result)["heading_swing"].state is State.HOLDS
    assert figures(result)["strength_offset"].state is State.DOUBTFUL
    assert "doubtful" in result.summary


def test_a_distorted_room_is_found_by_the_gyro_alone(calibration):
    """The robot sees a clean circle: the field's direction depends on where it looks."""
    clean = window(seed=6)
    bent = clean.time * 0.0 + np.radians(15.0) * np.sin(np.linspace(0, math.tau, len(clean)))
    cosine, sine = np.cos(bent), np.sin(bent)
    body = calibration.correction.apply(clean.field)
    x, y = cosine * body[:, 0] - sine * body[:, 1], sine * body[:, 0] + cosine * body[:, 1]
    raw = calibration.correction.undo(np.column_stack([x, y, body[:, 2]]))
    result = check(dataclasses.replace(clean, field=raw), calibration)
    found = figures(result)
    assert found["heading_swing"].state is State.HOLDS
    assert found["gyro_compass_rms"].after == pytest.approx(15.0 / math.sqrt(2.0), rel=0.15)
    assert result.state is State.STALE


def test_a_steady_gyro_bias_is_no_fault(calibration):
    biased = moved(gyro_bias=np.radians([0.3, -0.2, 0.8]))
    result = check(window(biased, seed=7), calibration)
    assert result.state is State.HOLDS, result.summary


def test_wobble_and_vibration_are_no_fault(calibration):
    wobble = smooth_wobble(np.random.default_rng(8), 700, 14.0, math.radians(4.0))
    shaky = moved(noise_force=0.5)
    result = check(window(shaky, seed=8, wobble=wobble), calibration)
    assert result.state is State.HOLDS, result.summary


def test_gaps_and_several_turns_do_not_upset_the_gyro(calibration):
    long = window(seed=9, samples=6000, duration=120.0, arc=9 * math.tau)
    keep = np.ones(len(long), dtype=bool)
    for first in (500, 1800, 3500):
        keep[first : first + 300] = False
    result = check(long.take(keep), calibration)
    assert result.state is State.HOLDS, result.summary


def test_a_turn_on_a_slope_is_looked_at_in_the_level_plane():
    """Installation known, so the slope itself is no fault."""
    robot = Robot(roll=0.0, pitch=0.0)
    level = calibrate(window(robot), robot.knowledge()).calibration
    slope = window(robot, seed=10, axis=np.array([0.0, 0.1, 1.0]))
    assert check(slope, level).state is State.HOLDS


def test_another_field_strength_is_another_place(calibration):
    result = check(window(moved(strength=60e-6), seed=11), calibration)
    assert result.state is State.STALE
    assert figures(result)["strength_offset"].after == pytest.approx(20.0, abs=1.0)


@pytest.mark.parametrize("bound", BOUNDS, ids=lambda bound: bound.figure)
def test_every_bound_grades_from_holds_to_stale(bound):
    scale = math.radians(1.0) if bound.unit == "°" else 0.01
    cases = (0.99 * bound.holds, 1.01 * bound.holds, 1.01 * bound.doubtful, math.nan)
    found = [bound.find(0.0, scale * value) for value in cases]
    assert [f.state for f in found] == [State.HOLDS, State.DOUBTFUL, State.STALE, State.STALE]
    assert "want" not in found[0].words
    assert bound.remedy in found[1].words
