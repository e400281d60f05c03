from dataclasses import replace

import numpy as np
import pytest

from magcal_ros.core.estimation.free_attitude import FreeBlock
from magcal_ros.core.estimation.leans import log_determinants, log_turn_informations
from magcal_ros.core.estimation.model import Evaluation
from magcal_ros.core.estimation.weighting import Noise

STEP = 1e-5
EVERY = np.arange(18)


@pytest.fixture
def block(state, samples, weighting):
    return FreeBlock(Evaluation(state, samples), weighting)


def test_gradient_against_differences(block):
    equations = block.equations(EVERY)
    coupling = equations.reduced(0.0).coupling

    def value(step):
        return 0.5 * block.moved(step, -coupling @ step).lean_cost

    numerical = [(value(STEP * axis) - value(-STEP * axis)) / (2 * STEP) for axis in np.eye(18)]
    np.testing.assert_allclose(equations.lean_gradient, numerical, atol=1e-5)


def test_what_turn_and_leans_hold_together_is_the_whole_information(block):
    """log det D = log det S + log D_zz."""
    local = block.local
    whole = np.linalg.slogdet(local.information)[1]
    parts = log_determinants(local) + np.log(local.information[:, 2, 2])
    np.testing.assert_allclose(parts, whole, rtol=1e-9)


def test_the_turn_holds_less_information_under_more_noise(block):
    noise = block.weighting.noise
    sure = log_turn_informations(block.local, noise)
    twice = Noise(2 * noise.up, 2 * noise.field, noise.wobble)
    loud = block.weighted(replace(block.weighting, noise=twice))
    np.testing.assert_allclose(
        sure - log_turn_informations(loud.local, loud.weighting.noise), np.log(4.0)
    )
