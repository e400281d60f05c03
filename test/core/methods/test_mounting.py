"""The mounting by gravity, compared with known rotations."""

from __future__ import annotations

import numpy as np
from simulated.turns import turn
from tumbles import SQUARE, hand_tumbling, tumbling

from magcal_ros.core.geometry import exp_rotation, unit
from magcal_ros.core.methods import estimate_mounting
from magcal_ros.core.simulation import DEGREE, UP_ENU

SIGMA = 3.0 * DEGREE
TURNED = np.array([0.02, -0.03, 0.04])


def seen(motion, rng, noise=0.01, rotation=TURNED):
    """Directions of a field that is turned back by `rotation`, and of up, with noise."""
    n = len(motion.time)
    true = motion.attitude @ unit(SQUARE.field_enu)
    field = true @ exp_rotation(rotation) + noise * rng.standard_normal((n, 3))
    return unit(field), unit(motion.attitude @ UP_ENU + noise * rng.standard_normal((n, 3)))


def test_tumbling_determines_a_rotation_with_a_correct_covariance():
    scores = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        found = estimate_mounting(*seen(tumbling(rng), rng))
        off = found.rotation - TURNED
        scores.append(off @ np.linalg.solve(found.covariance, off) / 3.0)
        np.testing.assert_allclose(found.rotation, TURNED, atol=0.005)
    assert 0.4 < np.mean(scores) < 1.6


def test_correlated_noise_counts_once():
    rng = np.random.default_rng(0)
    motion = hand_tumbling(rng)
    direction, up = seen(motion, rng)
    single = estimate_mounting(direction, up)
    repeated = estimate_mounting(np.repeat(direction, 10, axis=0), np.repeat(up, 10, axis=0))
    ratio = np.trace(repeated.covariance) / np.trace(single.covariance)
    assert 0.5 < ratio < 2.0


def test_a_level_turn_does_not_determine_the_yaw():
    rng = np.random.default_rng(0)
    found = estimate_mounting(*seen(turn(), rng))
    assert np.sqrt(found.covariance[2, 2]) > 0.7 * SIGMA
    assert np.sqrt(found.covariance[0, 0]) < 0.1 * SIGMA


def test_the_covariance_of_the_twelve_numbers_is_that_of_turned_matrices():
    rng = np.random.default_rng(0)
    found = estimate_mounting(*seen(tumbling(rng), rng))
    matrix = np.diag([0.8, 1.0, 1.3])
    drawn = rng.multivariate_normal(found.rotation, found.covariance, 4000)
    changes = np.array([(exp_rotation(d) @ matrix - matrix).ravel() for d in drawn])
    expected = changes.T @ changes / len(changes)
    covariance = found.covariance_of(matrix)
    assert not covariance[9:].any()
    # Small rotations, to first order: terms of the square of the angle are left out.
    np.testing.assert_allclose(covariance[:9, :9], expected, atol=0.1 * expected.max())
