"""The prior of the Earth's field, against integrals over a grid."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core import Belief, Knowledge, ReferenceField
from magcal_ros.core.knowledge import knowledge_of
from magcal_ros.core.smoother import EarthFieldPrior, GaussianEarthPrior

ANYWHERE = EarthFieldPrior.of(Knowledge().reference)
BOSTON = EarthFieldPrior.of(knowledge_of(51.3, inclination_deg=66.3).reference)
STEP = 0.5  # µT
LEVEL, DOWN = np.meshgrid(np.arange(-60.0, 110.0, STEP), np.arange(-140.0, 170.0, STEP))
GRID = np.stack([LEVEL.ravel(), DOWN.ravel()], axis=1)


def density(fields: EarthFieldPrior, at: np.ndarray) -> np.ndarray:
    found = np.zeros(len(at))
    for share, mean, covariance in zip(
        fields.shares, fields.means, fields.covariances, strict=True
    ):
        off = at - mean
        square = np.einsum("ni,ni->n", off, np.linalg.solve(covariance, off.T).T)
        found += share * np.exp(-0.5 * square) / math.sqrt(np.linalg.det(covariance))
    return found


@cache
def density_anywhere() -> np.ndarray:
    return density(ANYWHERE, GRID)


def posterior(prior: GaussianEarthPrior, information: np.ndarray, at: np.ndarray):
    total = prior.information + information
    mean = np.linalg.solve(total, prior.information @ prior.mean + information @ at)
    return mean, np.linalg.inv(total)


@examples(10)
@given(
    level=st.floats(15.0, 40.0),
    down=st.floats(-50.0, 55.0),
    sigma=st.floats(2.0, 20.0),
)
def test_mean_and_evidence_are_those_of_the_mixture(level, down, sigma) -> None:
    at, information = np.array([level, down]), np.diag([1.0, sigma**-2.0])
    prior = ANYWHERE.about(at)
    before, spread = posterior(prior, information, at)
    shift, covariance, gain = ANYWHERE.updated(prior, before, spread)
    off = GRID - at
    likely = np.exp(-0.5 * np.einsum("ni,ij,nj->n", off, information, off))
    by_all = density_anywhere() * likely
    expected = by_all @ GRID / by_all.sum()
    assert before + shift == pytest.approx(expected, abs=0.1)
    wide = EarthFieldPrior(np.ones(1), prior.mean[None], np.linalg.inv(prior.information)[None])
    by_one = density(wide, GRID) * likely
    assert gain == pytest.approx(math.log(by_all.sum() / by_one.sum()), abs=0.02)
    spread = math.sqrt(by_all @ (GRID[:, 1] - expected[1]) ** 2 / by_all.sum())
    assert math.sqrt(covariance[1, 1]) == pytest.approx(spread, rel=0.02)


def test_samples_that_show_the_hemisphere_show_the_downward_field() -> None:
    prior = ANYWHERE.about(np.array([20.0, 0.0]))
    information, at = np.diag([1.0, 10.0**-2.0]), np.array([20.0, 30.0])
    before, spread = posterior(prior, information, at)
    shift, covariance, _ = ANYWHERE.updated(prior, before, spread)
    assert 38.0 < (before + shift)[1] < 48.0
    assert covariance[1, 1] < 7.0**2


def test_a_level_turn_shows_no_hemisphere() -> None:
    prior = ANYWHERE.about(np.array([20.0, 0.0]))
    information, at = np.diag([1.0, 1e-9]), np.array([20.0, 0.0])
    _, covariance, _ = ANYWHERE.updated(prior, *posterior(prior, information, at))
    assert covariance[1, 1] > 20.0**2


def test_precise_samples_make_the_prior_irrelevant() -> None:
    """As several turns on slopes with quiet sensors do."""
    at, turned = np.array([25.0, 43.3]), np.array([[0.8, -0.6], [0.6, 0.8]])
    information = turned @ np.diag([1e12, 1e3]) @ turned.T
    prior = ANYWHERE.about(at + 1.0)
    before, spread = posterior(prior, information, at)
    shift, covariance, _ = ANYWHERE.updated(prior, before, spread)
    assert before + shift == pytest.approx(at, abs=0.01)
    assert np.linalg.inv(covariance) == pytest.approx(information, rel=1e-3)


def test_a_known_field_is_one_gaussian() -> None:
    assert BOSTON.is_known
    assert BOSTON.gaussian.mean == pytest.approx([20.6, 47.0], abs=0.1)
    assert BOSTON.about(np.array([5.0, 5.0])).mean == pytest.approx(BOSTON.gaussian.mean)


@pytest.mark.parametrize(
    ("reference", "at"),
    [
        (ReferenceField(strength=Belief(51.0e-6, 1e-6)), (20.0, 47.0)),
        (ReferenceField(inclination=Belief(math.radians(66.0), 0.02)), (20.5, 46.0)),
    ],
    ids=["strength", "inclination"],
)
def test_one_given_number_and_the_level_field_determine_the_field(reference, at) -> None:
    fields = EarthFieldPrior.of(reference)
    assert not fields.is_known
    assert fields.at_level(at[0])[1] == pytest.approx(at[1], abs=4.0)
