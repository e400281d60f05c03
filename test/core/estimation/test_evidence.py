"""A marginal likelihood is an integral, and knows the noise that made the samples."""

import math
from dataclasses import replace

import numpy as np
import pytest
from slope_turns import EAST, KNOWN, ROBOT, window_on

from magcal_ros.core.estimation.evidence import evidence, propagated_evidence, soft_evidence
from magcal_ros.core.estimation.free_attitude import FreeBlock
from magcal_ros.core.estimation.solver import Fit
from magcal_ros.core.methods.maximum_likelihood.fit import solve

QUARTER_DEGREE = math.radians(0.25)


def optimum(gyro):
    return solve(window_on(EAST, np.random.default_rng(1), gyro=gyro), KNOWN).choice.fit


@pytest.fixture(scope="module")
def free():
    fit = optimum(gyro=False)
    assert isinstance(fit.block, FreeBlock)
    assert not fit.block.leans
    return fit


@pytest.fixture(scope="module")
def propagated():
    return optimum(gyro=True)


def all_counted(block):
    return np.ones(len(block.samples), dtype=bool)


def turned(block, angle):
    return block.moved(np.zeros(18), np.full((len(block.samples), 1), angle))


def path_speed(block):
    """Return by how much up and field move for a turn of each sample, shape (n,)."""
    ahead, behind = (turned(block, angle).place.prediction for angle in (1e-5, -1e-5))
    up = (ahead.up_residual - behind.up_residual) / 2e-5
    field = (ahead.field_residual - behind.field_residual) / 2e-5
    return np.linalg.norm(np.hstack([up, field]), axis=1)


def integrated(block, prior):
    """Return minus twice the log of the likelihood, each turn angle summed over a grid.

    The prior of the angle is even along the path of up and field.
    """
    grid = np.arange(-40, 41) * QUARTER_DEGREE
    chi = np.array([turned(block, angle).chi.data for angle in grid])
    noise = block.weighting.noise
    likelihood = np.exp(-0.5 * chi).sum(axis=0) * QUARTER_DEGREE * path_speed(block)
    normal = len(block.samples) * (4.0 * math.log(noise.up) + 6.0 * math.log(noise.field))
    return float(-2.0 * np.log(likelihood).sum()) + normal + prior.cost(block.place.state.shared)


def test_it_is_the_integral_over_the_turn_angles_up_to_a_constant(free):
    block = free.block
    found = evidence(block, free.prior, all_counted(block), 1.0)
    # A Gaussian's integral is sqrt(2 pi) times its peak and its sigma.
    constant = len(block.samples) * math.log(2.0 * math.pi)
    assert found - constant == pytest.approx(integrated(block, free.prior), abs=0.5)


def test_only_inliers_speak(free):
    block = free.block
    half = np.arange(len(block.samples)) % 2 == 0
    parts = [evidence(block, free.prior, some, 0.0) for some in (half, ~half)]
    whole = evidence(block, free.prior, all_counted(block), 0.0)
    assert sum(parts) == pytest.approx(whole)


def with_field_noise(block, factor):
    noise = block.weighting.noise
    louder = replace(noise, field=factor * noise.field)
    return block.weighted(replace(block.weighting, noise=louder))


def best_factor(cost):
    factors = np.exp(np.linspace(-0.5, 0.5, 41))
    return factors[int(np.argmin([cost(factor) for factor in factors]))]


def true_factor(block, scale):
    return ROBOT.noise_field / scale / block.weighting.noise.field


def test_it_is_best_at_the_noise_that_made_the_samples(free):
    block = free.block
    best = best_factor(
        lambda f: evidence(with_field_noise(block, f), free.prior, all_counted(block), 1.0)
    )
    assert best == pytest.approx(true_factor(block, ROBOT.strength), rel=0.1)


def test_the_soft_forms_are_best_a_little_below_it(free, propagated):
    # Student's tails explain what a Gaussian needs its sigma for.
    soft = best_factor(lambda f: soft_evidence(with_field_noise(free.block, f), free.prior))
    assert 0.6 < soft / true_factor(free.block, ROBOT.strength) < 1.05
    best = best_factor(
        lambda f: propagated_evidence(
            Fit((with_field_noise(propagated.block, f),), propagated.prior), 1.0
        )
    )
    assert 0.6 < best / true_factor(propagated.block, ROBOT.strength) < 1.05


def test_fewer_independent_samples_weigh_less(propagated):
    # What the prior says does not shrink with them.
    one, four = (propagated_evidence(propagated, factor) for factor in (1.0, 4.0))
    own = propagated.block.errors @ propagated.block.prior_information @ propagated.block.errors
    believed = float(own) + propagated.prior.cost(propagated.shared)
    assert four - believed == pytest.approx((one - believed) / 4.0)
