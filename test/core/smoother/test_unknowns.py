"""The priors of the unknowns."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core import Knowledge
from magcal_ros.core.smoother import ALIKE, MODULE, priors_of

PRIORS = priors_of(Knowledge())


@given(st.lists(st.floats(0.2, 5.0), min_size=len(MODULE), max_size=len(MODULE)))
def test_the_quality_of_a_sensor_module_is_one_correlated_prior(factors):
    """The factors' densities, each by those before it, multiply to the joint normal one."""
    deviation = np.array(
        [math.log(f) / PRIORS.spread[name] for name, f in zip(MODULE, factors, strict=True)]
    )
    correlation = ALIKE + (1.0 - ALIKE) * np.eye(len(MODULE))
    joint = deviation @ np.linalg.solve(correlation, deviation)
    cost, known = 0.0, {}
    for name, factor in zip(MODULE, factors, strict=True):
        mean, variance = PRIORS.log_factor(name, known)
        cost += (math.log(factor) - mean) ** 2 / variance
        known[name] = factor
    assert math.isclose(cost, joint, rel_tol=1e-9, abs_tol=1e-9)


def test_other_groups_do_not_depend_on_the_sensor_module():
    cheap = dict.fromkeys(MODULE, 3.0)
    assert PRIORS.log_factor("latency", cheap) == (0.0, PRIORS.spread["latency"] ** 2)
    mean, variance = PRIORS.log_factor("axes", cheap)
    assert mean > 0.0
    assert variance < PRIORS.spread["axes"] ** 2


def test_a_distortion_is_of_axes_or_of_soft_iron():
    """The density of the whole is that of two independent causes whose squares add up."""
    rng = np.random.default_rng(0)
    axes = np.exp(PRIORS.spread["axes"] * rng.standard_normal(400_000))
    axes = axes[axes < PRIORS.most["axes"]]
    iron = np.exp(PRIORS.spread["soft_iron"] * rng.standard_normal(len(axes)))
    whole = np.log(np.hypot(axes, PRIORS.iron_over_axes * iron))
    counted, edges = np.histogram(whole, np.linspace(-2.0, 2.0, 21))
    middle = 0.5 * (edges[1:] + edges[:-1])
    density = np.exp(PRIORS.log_density("soft_iron", middle, {}))
    np.testing.assert_allclose(density / density.sum(), counted / counted.sum(), atol=2e-3)
    for factor in (0.5, 2.0, 5.0):
        x, log_density = PRIORS.factors_of("axes", {"soft_iron": factor})
        expected = np.average(np.exp(2.0 * x), weights=np.exp(log_density))
        near = np.abs(whole - math.log(factor)) < 0.05
        assert math.isclose(expected, np.mean(axes[near] ** 2), rel_tol=0.1)


def test_a_large_distortion_is_attributed_to_soft_iron():
    x, log_density = PRIORS.factors_of("axes", {"soft_iron": 30.0})
    expected = math.sqrt(np.average(np.exp(2.0 * x), weights=np.exp(log_density)))
    assert expected < PRIORS.most["axes"] / 2.0
