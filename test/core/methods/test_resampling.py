"""The jackknife compared with the scatter of many turns."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from honesty_cases import sigma_at
from simulated.turns import measure, turn

from magcal_ros.core import Belief, Correction, Knowledge, Reason, ReferenceField, Refusal, Window
from magcal_ros.core.methods import jackknife_covariance
from magcal_ros.core.methods.design_tip import fit
from magcal_ros.core.simulation import (
    DEGREE,
    LEVEL_TILT,
    UP_ENU,
    Robot,
    heading_errors,
    trial_attitudes,
)


def window_of(field):
    n = len(field)
    return Window(np.arange(n), field, np.tile([0.0, 0.0, 9.81], (n, 1)))


def mean_field(window, knowledge):
    return Correction(np.eye(3), window.field.mean(axis=0))


def test_a_mean_has_the_variance_of_a_mean():
    rng = np.random.default_rng(0)
    traces = [
        np.trace(
            jackknife_covariance(mean_field, window_of(rng.standard_normal((320, 3))), Knowledge())
        )
        for _ in range(100)
    ]
    assert np.mean(traces) == pytest.approx(3.0 / 320.0, rel=0.1)


def test_neighbours_with_correlated_errors_count_once():
    rng = np.random.default_rng(0)
    traces = [
        np.trace(
            jackknife_covariance(
                mean_field,
                window_of(np.repeat(rng.standard_normal((32, 3)), 10, axis=0)),
                Knowledge(),
            )
        )
        for _ in range(100)
    ]
    assert np.mean(traces) == pytest.approx(3.0 / 32.0, rel=0.1)


def test_the_reference_moves_by_its_sigma():
    def from_reference(window, knowledge):
        reference = knowledge.reference
        return Correction(
            np.eye(3), [reference.strength.value, 2.0 * reference.inclination.value, 0]
        )

    knowledge = Knowledge(ReferenceField(Belief(5.0, 0.3), Belief(1.0, 0.1)))
    window = window_of(np.ones((20, 3)))
    found = np.diag(jackknife_covariance(from_reference, window, knowledge))[9:]
    np.testing.assert_allclose(found, [0.09, 0.04, 0.0], atol=1e-12)
    silent = Knowledge(ReferenceField(Belief(5.0), Belief.unknown()))
    assert not jackknife_covariance(from_reference, window, silent).any()


def test_the_unobservable_part_is_added():
    unseen = np.arange(12.0)
    window = window_of(np.ones((20, 3)))
    found = jackknife_covariance(mean_field, window, Knowledge(), unknown=unseen)
    np.testing.assert_allclose(found, np.outer(unseen, unseen), atol=1e-12)


def test_a_result_that_depends_on_single_blocks_is_refused():
    def fragile(window, knowledge):
        if len(window) < 20:
            raise Refusal(Reason.NO_SOLUTION, "too short")
        return mean_field(window, knowledge)

    with pytest.raises(Refusal, match="some parts"):
        jackknife_covariance(fragile, window_of(np.ones((20, 3))), Knowledge())


@pytest.mark.nightly
@pytest.mark.parametrize("arc", [360.0, 180.0])
def test_the_predicted_heading_sigma_is_correct(arc):
    robot = Robot()
    poses = trial_attitudes()[:, LEVEL_TILT]
    up, field = poses @ UP_ENU, poses @ robot.field_enu
    true, predicted = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        start = (0.0, 0.0, rng.uniform(0.0, 2.0 * math.pi))
        window = measure(robot, turn(arc=arc * DEGREE, start_rpy=start), rng)
        estimate = fit(window, robot.knowledge())
        true.append(heading_errors(estimate.correction, robot, poses))
        predicted.append(sigma_at(estimate, up, field))
    ratio = np.sqrt(np.mean(np.square(predicted)) / np.mean(np.square(true)))
    assert 1.0 / 1.5 < ratio < 1.5


def test_a_wrong_inclination_is_within_its_given_sigma():
    robot = replace(Robot(), noise_field=1e-9, noise_force=1e-6)
    sigma = 2.0 * DEGREE
    window = measure(robot, turn(), np.random.default_rng(0))
    assumed = robot.knowledge(0.0, sigma)
    off = replace(
        assumed,
        reference=replace(assumed.reference, inclination=Belief(robot.inclination + sigma, sigma)),
    )
    estimate = fit(window, off)
    tilted = trial_attitudes()[:, 0]
    error = heading_errors(estimate.correction, robot, tilted)
    predicted = sigma_at(estimate, tilted @ UP_ENU, tilted @ robot.field_enu)
    np.testing.assert_allclose(np.abs(error), predicted, rtol=0.1, atol=1e-5)
