"""Elimination and inversion agree with the textbook, whatever the units."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.estimation.information import inverse_information, without_own

SEEDS = st.integers(0, 10_000)
UNITS = st.lists(st.floats(-6.0, 6.0), min_size=6, max_size=6)


def information(seed, units=(0.0,) * 6):
    root = np.random.default_rng(seed).normal(size=(12, 6)) * 10.0 ** np.array(units)
    return root.T @ root


@given(SEEDS, UNITS)
def test_the_inverse_does_not_care_for_units(seed, units):
    scale = 10.0 ** np.array(units)
    found = inverse_information(information(seed, units)) * np.outer(scale, scale)
    np.testing.assert_allclose(found, np.linalg.inv(information(seed)), rtol=1e-6, atol=1e-8)


def test_a_direction_without_information_is_huge_and_the_others_stay():
    bare = information(1)
    bare[3] = bare[:, 3] = 0.0
    found = inverse_information(bare)
    assert found[3, 3] > 1e6
    seen = [0, 1, 2, 4, 5]
    np.testing.assert_allclose(
        found[np.ix_(seen, seen)], np.linalg.inv(bare[np.ix_(seen, seen)]), rtol=1e-6
    )


@given(SEEDS, st.integers(0, 5))
def test_what_is_eliminated_leaves_the_covariance_of_the_rest(seed, own):
    whole = information(seed)
    rest = np.linalg.inv(without_own(whole, own))
    np.testing.assert_allclose(rest, np.linalg.inv(whole)[own:, own:], rtol=1e-5, atol=1e-9)
