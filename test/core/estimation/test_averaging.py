"""Neighbours are averaged without losing what they say."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.estimation.averaging import (
    SPIKES,
    TYPICAL_STRENGTH,
    field_scale,
    prepare,
    without_spikes,
)
from magcal_ros.core.knowledge import Belief, Knowledge
from magcal_ros.core.simulation.simulator import Robot, measure, turn

KNOWLEDGE = Robot().knowledge()


def turned(samples, seed=1):
    return measure(Robot(), turn(samples=samples), np.random.default_rng(seed))


def prepared(window, largest, knowledge=KNOWLEDGE):
    return prepare(window.field, window.specific_force, knowledge, largest)


@given(st.integers(2, 400), st.integers(1, 500))
def test_no_more_remain_than_were_asked_for_and_each_begins_where_it_says(samples, largest):
    window = turned(samples)
    out = prepared(window, largest)
    assert len(out.averaged) == len(out.first) <= largest
    assert out.first[0] == 0
    assert (np.diff(out.first) == math.ceil(samples / largest)).all()
    assert out.width * len(out.averaged) == pytest.approx(samples)


def test_few_samples_stay_as_they_are():
    window = turned(100)
    out = prepared(window, 100)
    assert out.averaged is out.all
    np.testing.assert_allclose(out.all.field * out.scale, window.field)


def test_up_is_a_unit_vector_before_and_after():
    out = prepared(turned(3000), 300)
    for samples in (out.all, out.averaged):
        np.testing.assert_allclose(np.linalg.norm(samples.up, axis=1), 1.0)


def test_the_noise_falls_as_if_each_sample_had_been_fitted():
    quiet = measure(
        replace(Robot(), noise_field=0.0), turn(samples=10_000), np.random.default_rng(1)
    )
    noisy = turned(10_000)
    gap = prepared(noisy, 100).averaged.field - prepared(quiet, 100).averaged.field
    expected = Robot().noise_field / Robot().strength / math.sqrt(100)
    assert np.std(gap) == pytest.approx(expected, rel=0.2)


def test_a_spike_is_left_out_of_its_average_and_nothing_else_is():
    window = turned(2000)
    spiked = window.field.copy()
    spiked[777] += 50e-6
    found = without_spikes(spiked)
    assert not found[777]
    assert found.mean() > 0.98
    gap = prepared(replace(window, field=spiked), 200).averaged.field
    gap = np.abs(gap - prepared(window, 200).averaged.field).max()
    assert gap * Robot().strength < 1e-6


def test_a_stretch_of_spikes_alone_is_averaged_all_the_same():
    values = np.zeros((100, 3))
    values[::2] = np.random.default_rng(1).normal(size=(50, 3))
    out = prepare(values + 1.0, np.ones((100, 3)), KNOWLEDGE, 100 // SPIKES.neighbours)
    assert np.isfinite(out.averaged.field).all()


@pytest.mark.parametrize("strength", [Belief(0.0, math.inf), Belief(0.0, 1e-6)])
def test_a_strength_that_is_no_scale_leaves_the_typical_one(strength):
    knowledge = Knowledge()
    reference = replace(knowledge.reference, strength=strength)
    assert field_scale(replace(knowledge, reference=reference)) == TYPICAL_STRENGTH
