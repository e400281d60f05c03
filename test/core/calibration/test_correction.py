from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core import Correction
from magcal_ros.core.calibration import MotorField, MotorInput
from magcal_ros.core.geometry import rotation_from_rpy

seeds = st.integers(0, 10_000)


def any_correction(seed):
    rng = np.random.default_rng(seed)
    gains = np.diag(rng.uniform(0.5, 2.0, 3))
    return Correction(
        gains @ rotation_from_rpy(*rng.uniform(-1, 1, 3)), 50e-6 * rng.uniform(-1, 1, 3)
    )


@given(seeds)
def test_undo_is_the_inverse_of_apply(seed):
    correction = any_correction(seed)
    field = 50e-6 * np.random.default_rng(seed).standard_normal((5, 3))
    np.testing.assert_allclose(correction.undo(correction.apply(field)), field, atol=1e-18)


@given(seeds, seeds)
def test_after_composes_two_corrections(first, second):
    first, second = any_correction(first), any_correction(second)
    field = np.array([[20e-6, -10e-6, 40e-6]])
    expected = second.apply(first.apply(field))
    np.testing.assert_allclose(second.after(first).apply(field), expected, atol=1e-18)


@given(seeds)
def test_parameters_are_recovered(seed):
    correction = any_correction(seed)
    again = Correction.from_parameters(correction.parameters)
    np.testing.assert_array_equal(again.matrix, correction.matrix)
    np.testing.assert_array_equal(again.hard_iron, correction.hard_iron)


def test_covariance_is_that_of_corrected_noise():
    correction = any_correction(3)
    sigma = np.diag([1.0, 4.0, 9.0])
    noise = np.random.default_rng(0).multivariate_normal(np.zeros(3), sigma, 200_000)
    seen = np.cov(correction.apply(noise).T)
    np.testing.assert_allclose(correction.covariance(sigma), seen, rtol=0.05, atol=0.1)


def test_identity_changes_nothing():
    field = np.array([[1e-6, 2e-6, 3e-6]])
    np.testing.assert_array_equal(Correction.identity().apply(field), field)


@pytest.mark.parametrize(
    "matrix", [np.zeros((3, 3)), np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan), np.eye(2)]
)
def test_impossible_matrices_are_rejected(matrix):
    with pytest.raises(ValueError, match="matrix"):
        Correction(matrix, np.zeros(3))


def test_a_correction_is_immutable():
    matrix = np.eye(3)
    correction = Correction(matrix, np.zeros(3))
    matrix[0, 0] = 7.0
    assert correction.matrix[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        correction.matrix[0, 0] = 7.0


def motors_of(inputs, size):
    """A field of the motors whose gains and usual inputs are all of one size."""
    count = 3 * len(inputs)
    gain, covariance = np.full((len(inputs), 3), size), size**2 * np.eye(count)
    usual = (size,) * len(inputs)
    return MotorField(inputs, gain, covariance, np.full((12, count), size), size, usual)


def test_a_newer_motor_field_keeps_what_only_the_older_one_has():
    newer = motors_of((MotorInput.MOVING, MotorInput.CURRENT), 1.0)
    older = motors_of((MotorInput.CURRENT, MotorInput.SPEED), 2.0)
    both = newer.combined_with(older)
    assert both.inputs == (MotorInput.MOVING, MotorInput.CURRENT, MotorInput.SPEED)
    np.testing.assert_array_equal(both.gain[:, 0], [1.0, 1.0, 2.0])
    np.testing.assert_array_equal(np.diag(both.covariance), np.repeat([1.0, 1.0, 4.0], 3))
    np.testing.assert_array_equal(both.cross_covariance[0], np.repeat([1.0, 1.0, 0.0], 3))
    assert (both.ripple, both.usual) == (1.0, (1.0, 1.0, 2.0))
