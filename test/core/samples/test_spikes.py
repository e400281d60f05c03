"""Single wrong samples of the field: they are found, and a turn is calibrated as without them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from long_form import first_of
from realistic_robots import by_rested_turn, collected, heading_error

from magcal_ros.core import calibrate
from magcal_ros.core.calibration import predicted_heading_sigma
from magcal_ros.core.samples import spikes_replaced
from magcal_ros.core.simulation import DEGREE

pytestmark = pytest.mark.usefixtures("right_axes")

MICROTESLA = 1e-6


def turning_field(samples: int, noise: float, seed: int) -> np.ndarray:
    yaw = np.linspace(0.0, 2.0 * np.pi, samples)
    field = 30.0 * np.column_stack([np.cos(yaw), -np.sin(yaw), np.full(samples, -1.0)])
    return field + noise * np.random.default_rng(seed).standard_normal((samples, 3))


@given(share=st.floats(0.0, 0.15), seed=st.integers(0, 1000))
def test_spikes_are_replaced_by_what_their_neighbours_measure(share, seed):
    clean = turning_field(400, 0.2, seed)
    rng = np.random.default_rng(seed + 1)
    hit = rng.random(400) < share
    spoilt = clean + np.where(hit, rng.choice([-20.0, 20.0], 400), 0.0)[:, None]
    left = np.abs(spikes_replaced(spoilt) - clean).max(axis=1)
    # Where spikes are most of nine neighbours, the median is one of them.
    assert np.mean(left > 3.0) < 0.02
    assert np.mean(left[~hit] > 1.0) < 0.02


@pytest.mark.parametrize("samples", [30, 60, 400])
def test_a_field_that_turns_fast_has_no_spikes(samples):
    clean = turning_field(samples, 0.01, 1)
    np.testing.assert_array_equal(spikes_replaced(clean), clean)


def test_single_steps_of_a_coarse_sensor_are_no_spikes():
    steps = np.zeros((300, 3))
    steps[::11] = 0.3
    np.testing.assert_array_equal(spikes_replaced(steps), steps)


@pytest.mark.parametrize("seed", first_of([130700, 130701, 130702]))
def test_a_tenth_of_spikes_does_not_spoil_a_turn(seed):
    scene, knowledge = by_rested_turn("even", "typical", "open")(seed)
    rng = np.random.default_rng(seed)
    hit = rng.random(len(scene.window)) < 0.1
    spikes = np.where(hit[:, None], 15.0 * MICROTESLA * rng.standard_normal((len(hit), 3)), 0.0)
    window = collected(replace(scene.window, field=scene.window.field + spikes))
    estimate = calibrate(window, knowledge).estimate
    assert predicted_heading_sigma(estimate) < 1.0 * DEGREE
    assert heading_error(scene, estimate.correction) < 3.0 * predicted_heading_sigma(estimate)
