"""The current of a battery in the nodes of a turn."""

import math

import numpy as np
import pytest

from magcal_ros.core.samples import battery_of, with_one_reference
from magcal_ros.core.smoother import Clock, Currents

STAMPS = np.arange(0.0, 10.0, 0.125)


def reported(current):
    return list(zip(STAMPS.tolist(), np.asarray(current, dtype=float).tolist(), strict=True))


def pulse(time):
    return -0.5 - 3.0 * np.exp(-((np.asarray(time) - 5.0) ** 2))


def clock(battery, starts=(), stops=()):
    """Return the clock of a robot that turns at .5 rad/s from each start to each stop."""
    time = np.arange(0.5, 9.5, 0.02)
    turns = np.zeros(len(time))
    for start, stop in zip(starts, stops, strict=True):
        turns += np.clip((time - start) / 0.2, 0.0, 1.0) - np.clip((time - stop) / 0.2, 0.0, 1.0)
    rate = 0.5 * turns[:, None] * [0.0, 0.0, 1.0]
    return Clock.of(battery, time, rate, turns == 0.0)


@pytest.mark.nightly
def test_the_mean_of_a_node_allows_for_the_latency_of_the_current():
    battery = battery_of(reported(pulse(STAMPS)), 0.5, 9.5)
    begin = np.arange(1.0, 9.0, 0.6)
    currents = Currents(battery, clock(battery), begin, begin + 0.6)
    for delay in (0.0, 0.1, 0.37, -0.2):
        mean, change = currents.at(delay), currents.change(delay)
        inside = begin[:, None] + 0.6 * (np.arange(200) + 0.5) / 200 + delay
        np.testing.assert_allclose(mean + battery.reference, pulse(inside).mean(axis=1), atol=0.01)
        step = 0.01
        differs = (currents.at(delay + step) - currents.at(delay - step)) / (2.0 * step)
        np.testing.assert_allclose(change, differs, atol=0.1)


def test_a_rest_beside_the_turn_has_its_own_mean():
    battery = battery_of(reported(pulse(STAMPS)), 0.5, 9.5)
    currents = Currents(battery, clock(battery), np.array([4.0]), np.array([6.0]))
    currents = currents.with_rest(0, 1.0, 2.0)
    mean = currents.at(0.0)
    assert mean[:2] == pytest.approx([0.0, 0.0], abs=0.01)
    assert mean[2] < -1.5


def test_between_slow_messages_the_current_changes_at_starts_and_stops():
    stamps = np.arange(0.0, 10.5, 1.0)
    starts, stops = (2.3, 6.4), (4.6, 8.3)

    def current(time):
        runs = sum((time > a) & (time < b + 0.2) for a, b in zip(starts, stops, strict=True))
        return -0.5 - 3.0 * runs - 1.0 * ((time > 4.7) & (time < 6.4))

    messages = list(zip(stamps.tolist(), current(stamps - 0.1).tolist(), strict=True))
    battery = battery_of(messages, 0.5, 9.5)
    begin = np.arange(0.5, 9.0, 0.25)
    currents = Currents(battery, clock(battery, starts, stops), begin, begin + 0.25)
    mean = currents.at(0.1)
    inside = begin[:, None] + 0.25 * (np.arange(50) + 0.5) / 50
    off = np.abs(mean + battery.reference - current(inside).mean(axis=1))
    sigma = np.sqrt(currents.variance(0.1))
    edges = np.array([*starts, *stops])[:, None] + 0.1
    near = (np.abs(begin + 0.125 - edges) < 0.4).any(axis=0)
    assert off[~near].max() < 0.3
    assert off[near].max() > 1.0
    assert (off < 3.0 * sigma + 0.1).all()
    assert np.median(sigma[~near]) < 0.3 < np.median(sigma[near])


def test_an_unsampled_ripple_is_in_the_variance_and_not_in_the_mean():
    rng = np.random.default_rng(0)
    stamps = np.arange(-1.0, 61.0, 1.0)
    moves = (stamps > 1.0) & (stamps < 59.0)
    ripple = rng.normal(0.0, 0.7, len(stamps))
    messages = list(zip(stamps.tolist(), (-1.0 - moves * (2.0 + ripple)).tolist(), strict=True))
    battery = battery_of(messages, 0.0, 60.0)
    time = np.arange(0.0, 60.0, 0.05)
    turns = (time > 1.0) & (time < 59.0)
    found = Clock.of(battery, time, 0.4 * turns[:, None] * [0.0, 0.0, 1.0], ~turns)
    assert math.sqrt(found.ripple) == pytest.approx(0.7, rel=0.35)
    begin = np.arange(3.0, 57.0, 0.5)
    currents = Currents(battery, found, begin, begin + 0.5)
    mean = currents.at(0.0)
    assert math.sqrt(np.mean((mean + battery.reference + 3.0) ** 2)) < 0.4
    assert np.sqrt(currents.variance(0.0)).min() > 0.5


SERIES = {
    "noise": lambda rng, time: rng.normal(0.0, 1.0, len(time)),
    "walk": lambda rng, time: np.cumsum(rng.normal(0.0, 1.0, len(time))),
    "one step": lambda rng, time: 1.0 * (time > 5.0),
    "one message": lambda rng, time: 1.0 * (np.arange(len(time)) == 7),
    "a ramp": lambda rng, time: time,
    "to and fro": lambda rng, time: (-1.0) ** np.arange(len(time)),
}


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("name", SERIES)
@pytest.mark.parametrize("gap", [1.0, 0.125, 0.02])
def test_every_series_of_messages_gives_means_and_variances(name, size, gap):
    stamps = np.arange(-0.5, 10.6, gap)
    values = size * SERIES[name](np.random.default_rng(1), stamps)
    battery = battery_of(list(zip(stamps.tolist(), values.tolist(), strict=True)), 0.5, 9.5)
    begin = np.arange(0.5, 9.0, 0.25)
    currents = Currents(battery, clock(battery, (2.3,), (4.6,)), begin, begin + 0.25)
    mean, change = currents.at(0.1), currents.change(0.1)
    assert np.isfinite(change).all()
    assert np.abs(mean + battery.reference).max() < 1.5 * np.abs(values).max()
    variance = currents.variance(0.1)
    assert (variance > 0.0).all()
    assert variance.max() < 100.0 * np.ptp(values) ** 2


def test_the_least_current_is_the_reference_without_fed_back_current():
    current = np.where(STAMPS < 3.0, -0.5, -4.0)
    current[50:52] = [0.0, 2.0]
    assert battery_of(reported(current), 0.5, 9.5).reference == -0.5


@pytest.mark.parametrize(
    "messages",
    [
        [],
        reported(0.0 * STAMPS),
        reported(np.full(len(STAMPS), -1.2)),
        reported(np.full(len(STAMPS), math.nan)),
        reported(pulse(STAMPS))[:-20],
        reported(pulse(STAMPS))[20:],
        reported(pulse(STAMPS))[:30] + reported(pulse(STAMPS))[45:],
    ],
)
def test_a_current_with_gaps_is_not_used(messages):
    assert battery_of(messages, 0.5, 9.5) is None


def test_turns_share_a_reference():
    one = battery_of(reported(pulse(STAMPS)), 0.5, 9.5)
    other = battery_of(reported(pulse(STAMPS) - 1.0), 0.5, 9.5)
    assert [b.reference for b in with_one_reference([other, one])] == [one.reference] * 2
    assert with_one_reference([one, None]) == [None, None]
