"""Rests are separated from the turn and give the gyro's bias."""

import math
from dataclasses import replace

import numpy as np
import pytest
from uneven_turns import DEGREE, REST, ROBOT, SECONDS, collected, driven, evenly, stop_and_go

from magcal_ros.core import calibrate
from magcal_ros.core.samples import COLUMNS, GyroAtRest, rest

BIAS = np.array([0.3, -0.2, 0.1]) * DEGREE


@pytest.mark.parametrize("course", [evenly, stop_and_go])
def test_rests_before_and_after_are_separated_from_the_turn(course):
    window = collected(driven(course, replace(ROBOT, gyro_bias=BIAS))[1])
    before, after = window.rests
    assert -0.6 < window.time[0] <= 0.0
    assert SECONDS <= window.time[-1] < SECONDS + 0.6
    for beside, end in ((before, window.time[0]), (after, window.time[-1])):
        assert beside.beside == end
        assert beside.seconds == pytest.approx(REST - 0.5, abs=0.2)
        np.testing.assert_allclose(beside.rate, BIAS, atol=5.0 * beside.rate_sigma)
        assert beside.rate_sigma < 4e-4
        np.testing.assert_allclose(beside.turned, np.eye(3), atol=1e-3)


def test_a_rest_long_before_the_turn_is_not_attached(monkeypatch):
    """A long recording is thinned, which may leave a minute between the two."""
    _, window = driven(evenly)
    time = np.where(np.arange(len(window)) < 30, window.time - 60.0, window.time)
    sensors = window.field, window.specific_force, window.angular_rate
    rows = np.column_stack([time, *sensors, np.full((len(time), COLUMNS - 10), np.nan)])
    monkeypatch.setattr(rest, "rests_around", lambda *_: (30, len(rows) - 30, None))
    turn, rests, _ = rest.without_rests(rows)
    assert len(turn) == len(rows) - 60
    assert [each.beside for each in rests] == [rows[-31, 0]]


def test_a_small_bias_is_subtracted():
    motion, window = driven(evenly, replace(ROBOT, gyro_bias=BIAS))
    turned = collected(window)
    left = turned.angular_rate - motion.angular_rate[np.isin(motion.time, turned.time)]
    np.testing.assert_allclose(left.mean(axis=0), 0.0, atol=5e-4)


def test_stops_within_the_turn_keep_the_gyro_angle():
    motion, window = driven(stop_and_go)
    turned = collected(window)
    rows = np.isin(motion.time, turned.time)
    truth = motion.attitude[rows] @ motion.attitude[rows][0].T
    attitude = turned.steps.attitude
    away = attitude @ attitude[0].T @ np.swapaxes(truth, 1, 2)
    assert np.abs(away - np.eye(3)).max() < 0.3 * DEGREE


def test_a_turn_without_a_rest_has_no_attached_rests():
    assert collected(driven(lambda time: 1.0 + 0.0 * time)[1]).rests == ()


@pytest.mark.parametrize("gyro", [True, False])
def test_a_window_at_rest_is_unchanged(gyro):
    standing = driven(evenly)[1].take(np.arange(80))
    window = collected(standing if gyro else replace(standing, angular_rate=None))
    assert window.rests == ()
    assert len(window) > 70


def test_without_a_gyro_the_field_shows_a_rest():
    window = collected(replace(driven(evenly)[1], angular_rate=None))
    before, after = window.rests
    assert -0.6 < window.time[0] <= 0.0
    assert SECONDS <= window.time[-1] < SECONDS + 0.6
    assert (before.beside, after.beside) == (window.time[0], window.time[-1])
    assert before.rate_sigma == after.rate_sigma == math.inf
    assert collected(replace(driven(lambda t: 1.0 + 0.0 * t)[1], angular_rate=None)).rests == ()


def test_a_known_bias_is_subtracted_without_a_rest():
    known = GyroAtRest(tuple(BIAS), 2e-4)
    moving = driven(lambda time: 1.0 + 0.0 * time, replace(ROBOT, gyro_bias=BIAS))
    for (motion, window), sigma in ((moving, known.later_sigma), (driven(evenly), None)):
        found = collected(window, GyroAtRest(tuple(BIAS), 2e-4))
        rows = np.isin(motion.time, found.time)
        left = (found.angular_rate - motion.angular_rate[rows]).mean(axis=0)
        np.testing.assert_allclose(left, 0.0, atol=5e-4)
        assert found.bias_sigma == (sigma or min(each.rate_sigma for each in found.rests))
        assert math.isinf(found.sigma_before) == (sigma is None)


def test_without_a_rest_the_bias_is_unknown():
    window = collected(driven(lambda time: 1.0 + 0.0 * time)[1])
    assert math.isinf(window.bias_sigma)
    assert math.isinf(window.take(np.arange(100)).bias_sigma)


def test_spikes_of_the_field_hide_no_rest():
    """Without the rests, a field of motors that run in the turn was taken for hard iron."""
    moved = driven(evenly)[1]
    rng = np.random.default_rng(3)
    hit = rng.random(len(moved)) < 0.02
    spikes = 15e-6 * rng.standard_normal(moved.field.shape) * hit[:, None]
    clean, spiky = collected(moved), collected(replace(moved, field=moved.field + spikes))
    for found, expected in zip(spiky.rests, clean.rests, strict=True):
        assert found.seconds == pytest.approx(expected.seconds, abs=0.2)
        np.testing.assert_allclose(found.field, expected.field, atol=0.1e-6)


def test_rests_of_less_than_a_second_show_the_motors():
    """The field of motors that run in the turn was taken for hard iron."""
    moved = driven(evenly)[1]
    inside = (moved.time > -0.7) & (moved.time < SECONDS + 0.7)
    brief = moved.take(inside)
    runs = (brief.time > 0.0) & (brief.time < SECONDS)
    motors = np.array([6e-6, 6e-6, 0.0])
    brief = replace(brief, field=brief.field + np.outer(runs, motors))
    found = calibrate(collected(brief), replace(ROBOT.knowledge(), exact_sensors=False))
    assert found.estimate.correction.hard_iron == pytest.approx(ROBOT.hard_iron, abs=1.5e-6)
    assert found.estimate.motors is not None
