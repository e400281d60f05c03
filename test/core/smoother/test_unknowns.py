"""What is believed of the unknowns before the samples."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoother.priors import priors_of
from magcal_ros.core.smoother.unknowns import ALIKE, MODULE

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
