import math

import numpy as np
import pytest

from magcal_ros.core.geometry import Slope


def slope_of(predicted, measured, memory=math.inf, seconds=0.0):
    slope = Slope(memory)
    for x, y in zip(predicted, measured, strict=True):
        slope.add(x * y, x * x, y * y, seconds)
    return slope


def test_without_evidence_nothing_is_known():
    assert Slope(math.inf).bounds(3.0) == (-math.inf, math.inf)


@pytest.mark.parametrize("true", [1.0, 0.0, -1.0])
def test_the_slope_is_within_its_bounds(true):
    rng = np.random.default_rng(3)
    predicted = rng.standard_normal(400)
    least, most = slope_of(predicted, true * predicted + rng.standard_normal(400)).bounds(3.0)
    assert least < true < most
    assert most - least == pytest.approx(6.0 / math.sqrt(400.0), rel=0.2)


@pytest.mark.parametrize("true", [1.0, 0.0])
def test_the_odds_are_for_the_likelier_slope(true):
    rng = np.random.default_rng(4)
    predicted = rng.standard_normal(40)
    odds = slope_of(predicted, true * predicted + rng.standard_normal(40)).log_odds
    assert (odds > 5.0) if true else (odds < -5.0)
    assert Slope(math.inf).log_odds == 0.0


def test_old_evidence_is_forgotten():
    slope = slope_of([1.0] * 200, [-1.0] * 100 + [1.0] * 100, memory=20.0, seconds=1.0)
    assert slope.bounds(0.0)[0] > 0.9
