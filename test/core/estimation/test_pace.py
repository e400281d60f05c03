"""How fast a turn goes, and how unevenly."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magcal_ros.core.estimation.pace import pace_of
from magcal_ros.core.samples.window import Window

TIME = np.arange(0.0, 20.0, 0.02)
FIRST = np.arange(0, len(TIME), 10)
INSIDE = slice(10, -10)


def paced(rate):
    rates = np.column_stack([0.0 * rate, 0.0 * rate, rate])
    up = np.tile([0.0, 0.0, 9.81], (len(TIME), 1))
    window = Window(TIME, np.ones((len(TIME), 3)) * 4e-5, up, rates)
    return pace_of(window, np.diff(TIME)[:, None] * 0.5 * (rates[1:] + rates[:-1]), FIRST)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.1, 3.0), st.sampled_from([-1.0, 1.0]))
def test_an_even_turn_has_one_rate_and_nothing_else(speed, sense):
    pace = paced(sense * speed * np.ones(len(TIME)))
    np.testing.assert_allclose(pace.axis, [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(pace.about[INSIDE], sense * speed, rtol=1e-6)
    np.testing.assert_allclose(pace.swing[INSIDE], 0.0, atol=1e-6)
    np.testing.assert_allclose(pace.swiftness[INSIDE], 0.0, atol=0.1)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.1, 0.6), st.floats(4.0, 10.0))
def test_an_uneven_turn_is_followed(share, period):
    phase = math.tau * TIME / period
    pace = paced(0.5 * (1.0 + share * np.sin(phase)))
    middle = np.add.reduceat(phase, FIRST)[INSIDE] / 10
    np.testing.assert_allclose(pace.about[INSIDE], 0.5 * (1.0 + share * np.sin(middle)), atol=0.01)
    change = 0.5 * share * math.tau / period * np.cos(middle)
    np.testing.assert_allclose(pace.swing[INSIDE], change, atol=0.06 * np.abs(change).max() + 1e-3)
    # Averaged over a second it follows the square of the rate, and the mean of all is none.
    alike = np.corrcoef(pace.swiftness[INSIDE], pace.about[INSIDE] ** 2)[0, 1]
    assert alike > 0.97
    assert pace.swiftness.mean() == pytest.approx(0.0, abs=0.05)


def test_one_jerk_says_nothing_of_the_speed():
    rate = 0.05 * np.ones(len(TIME))
    rate[500:560] = 5.0
    assert paced(rate).swiftness.max() <= 3.0
