"""Several turns as blocks of nodes that share the calibration."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from simulated.turns import measure
from slope_turns import EAST, KNOWN, LEVEL, NORTH, ROBOT, motion_on, window_on

from magcal_ros.core.smoother import (
    AT,
    TURNED,
    Fit,
    JointFit,
    fit_jointly,
    imagined_information,
    smooth,
    smooth_by_field,
)

SIGMA = KNOWN.mounting.yaw_sigma


@pytest.fixture(scope="module")
def alone() -> list[Fit]:
    rng = np.random.default_rng(3)
    return [smooth_by_field(window_on(slope, rng), KNOWN).fit for slope in (LEVEL, EAST)]


@pytest.fixture(scope="module")
def joint(alone: list[Fit]) -> JointFit:
    return fit_jointly(alone, SIGMA)


@pytest.mark.nightly
def test_turns_of_one_robot_share_only_the_calibration(joint: JointFit) -> None:
    one, other = (fit.state.shared for fit in joint.fits)
    for name in ("iron", "installation", "turned", "earth", "soft_iron"):
        np.testing.assert_allclose(one[AT[name]], other[AT[name]], rtol=1e-9)
    assert joint.fits[0].point.sizes != joint.fits[1].point.sizes


def test_the_information_of_turns_adds_up_to_the_covariance(joint: JointFit) -> None:
    known = joint.prior + np.sum(joint.informations, axis=0)
    rows = np.flatnonzero(np.diag(known) > 0.0)
    covariance = np.linalg.inv(known[np.ix_(rows, rows)])
    iron = np.isin(rows, np.arange(AT["iron"].start, AT["iron"].stop))
    np.testing.assert_allclose(
        covariance[np.ix_(iron, iron)], joint.fits[0].covariance[AT["iron"], AT["iron"]], rtol=1e-3
    )


def test_a_joint_fit_of_one_turn_has_the_same_sigma(alone: list[Fit]) -> None:
    at = AT["installation"]
    joined = fit_jointly(alone[:1], 1e-4).fits[0].covariance[at, at]
    found = np.sqrt(np.diag(joined) / np.diag(alone[0].covariance[at, at]))
    np.testing.assert_allclose(found, 1.0, atol=0.04)


def test_the_order_of_turns_does_not_matter(alone: list[Fit], joint: JointFit) -> None:
    other = fit_jointly(alone[::-1], SIGMA)
    assert other.evidence == pytest.approx(joint.evidence, abs=3.0)
    sigma = np.sqrt(np.diag(joint.fits[0].covariance))[AT["iron"]]
    off = other.fits[0].state.shared[AT["iron"]] - joint.fits[0].state.shared[AT["iron"]]
    assert np.all(np.abs(off) < 0.2 * sigma)


def test_an_imagined_repetition_has_the_same_information(joint: JointFit) -> None:
    again = imagined_information(joint.fits[1], np.eye(3), np.eye(3))
    found = np.diag(again)[AT["iron"]] / np.diag(joint.informations[1])[AT["iron"]]
    assert np.all((found > 0.7) & (found < 1.5))


@pytest.mark.nightly
@pytest.mark.parametrize("gyro", first_of([True, False]))
def test_a_field_that_differs_from_place_to_place_is_in_the_sigma(gyro: bool) -> None:
    rng = np.random.default_rng(4)
    knowledge = replace(KNOWN, exact_sensors=False)
    fit = smooth if gyro else smooth_by_field
    fits = []
    for slope in (LEVEL, EAST, NORTH):
        motion = motion_on(slope, rng.uniform(0.0, math.tau))
        window = measure(ROBOT, motion, rng, gyro=gyro)
        there = motion.attitude @ (0.5e-6 * rng.standard_normal(3))
        window = replace(window, field=window.field + there @ ROBOT.distortion.T)
        fits.append(fit(window, knowledge).fit)
    found = fit_jointly(fits, SIGMA).fits[0]
    sigma = math.sqrt(found.covariance[TURNED, TURNED])
    assert abs(found.state.shared[TURNED] - ROBOT.yaw) < 3.0 * sigma
