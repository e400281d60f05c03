"""The current of a battery in the nodes of a turn."""

import math

import numpy as np
import pytest

from magcal_ros.core.samples.battery import battery_of, with_one_reference
from magcal_ros.core.smoother.currents import Currents

STAMPS = np.arange(0.0, 10.0, 0.125)


def told(current):
    return list(zip(STAMPS.tolist(), np.asarray(current, dtype=float).tolist(), strict=True))


def pulse(time):
    return -0.5 - 3.0 * np.exp(-((np.asarray(time) - 5.0) ** 2))


def test_the_mean_of_a_node_is_that_of_the_current_before_it_was_told():
    battery = battery_of(told(pulse(STAMPS)), 0.5, 9.5)
    begin = np.arange(1.0, 9.0, 0.6)
    currents = Currents(battery, begin, begin + 0.6)
    for delay in (0.0, 0.1, 0.37, -0.2):
        mean, change = currents.at(delay)
        inside = begin[:, None] + 0.6 * (np.arange(200) + 0.5) / 200 + delay
        np.testing.assert_allclose(mean + battery.reference, pulse(inside).mean(axis=1), atol=0.01)
        step = 1e-5
        differs = (currents.at(delay + step)[0] - currents.at(delay - step)[0]) / (2.0 * step)
        np.testing.assert_allclose(change, differs, atol=1e-4)


def test_a_rest_beside_the_turn_has_its_own_mean():
    battery = battery_of(told(pulse(STAMPS)), 0.5, 9.5)
    currents = Currents(battery, np.array([4.0]), np.array([6.0])).with_rest(0, 1.0, 2.0)
    mean, _ = currents.at(0.0)
    assert mean[:2] == pytest.approx([0.0, 0.0], abs=0.01)
    assert mean[2] < -1.5


def test_the_least_current_is_the_reference_and_none_given_back():
    current = np.where(STAMPS < 3.0, -0.5, -4.0)
    current[50:52] = [0.0, 2.0]
    assert battery_of(told(current), 0.5, 9.5).reference == -0.5


@pytest.mark.parametrize(
    "messages",
    [
        [],
        told(0.0 * STAMPS),
        told(np.full(len(STAMPS), -1.2)),
        told(np.full(len(STAMPS), math.nan)),
        told(pulse(STAMPS))[:-20],
        told(pulse(STAMPS))[20:],
        told(pulse(STAMPS))[:30] + told(pulse(STAMPS))[45:],
    ],
)
def test_a_current_that_is_not_known_throughout_is_not_used(messages):
    assert battery_of(messages, 0.5, 9.5) is None


def test_turns_share_a_reference():
    one = battery_of(told(pulse(STAMPS)), 0.5, 9.5)
    other = battery_of(told(pulse(STAMPS) - 1.0), 0.5, 9.5)
    assert [b.reference for b in with_one_reference([other, one])] == [one.reference] * 2
    assert with_one_reference([one, None]) == [None, None]
