from __future__ import annotations

import numpy as np
import pytest
from examples import examples
from honesty_cases import sigma_at
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core import Correction, Estimate, Installation
from magcal_ros.core.calibration import yaw_jacobian
from magcal_ros.core.geometry import rotation_from_rpy, yaw_from_up_and_field
from magcal_ros.core.simulation import DEGREE, UP_ENU, Robot, trial_attitudes


def estimate_with(covariance):
    return Estimate(
        method="none",
        correction=Robot().true_correction,
        covariance=covariance,
        installation=None,
        axis=UP_ENU,
        arc=6.0,
        strength=50e-6,
        inclination=60.0 * DEGREE,
        noise_field=0.0,
        noise_up=0.0,
        inliers=np.ones(0, dtype=bool),
        residual=np.zeros((0, 3)),
    )


@examples(30)
@given(st.integers(0, 1000))
def test_yaw_jacobian_is_the_derivative(seed):
    rng = np.random.default_rng(seed)
    robot = Robot(roll=rng.uniform(-1, 1), pitch=rng.uniform(-1, 1))
    attitude = rotation_from_rpy(*rng.uniform(-0.5, 0.5, 3)).T
    up, field = attitude @ UP_ENU, attitude @ robot.field_enu
    raw, parameters = robot.raw_field(field), robot.true_correction.parameters
    jacobian = yaw_jacobian(robot.true_correction, up, field)
    for index in range(12):
        step = np.zeros(12)
        step[index] = 1e-6 if index < 9 else 1e-11
        yaws = [
            float(yaw_from_up_and_field(up, Correction.from_parameters(parameters + s).apply(raw)))
            for s in (step, -step)
        ]
        slope = np.angle(np.exp(1j * (yaws[0] - yaws[1]))) / (2.0 * step[index])
        assert jacobian[index] == pytest.approx(slope, rel=1e-5, abs=1e-5 * np.abs(jacobian).max())


def test_hard_iron_sigma_in_the_plane_becomes_heading_sigma_over_the_radius():
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = (0.25e-6) ** 2 * np.eye(3)
    estimate = estimate_with(covariance)
    attitude = trial_attitudes()[:, 4]
    sigma = sigma_at(estimate, attitude @ UP_ENU, attitude @ Robot().field_enu)
    np.testing.assert_allclose(sigma, 0.25e-6 / estimate.circle_radius, rtol=1e-9)


def test_without_uncertainty_the_sigma_is_zero():
    sigma = sigma_at(estimate_with(np.zeros((12, 12))), UP_ENU, Robot().field_enu)
    assert float(sigma) == 0.0


def test_covariance_must_be_twelve_by_twelve_and_finite():
    for wrong in (np.zeros((3, 3)), np.full((12, 12), np.nan)):
        with pytest.raises(ValueError, match="covariance"):
            estimate_with(wrong)


def test_the_installation_angle_combines_roll_pitch_and_yaw():
    assert Installation(0.1, 0.0).angle == pytest.approx(0.1)
    assert Installation(0.0, -0.2).angle == pytest.approx(0.2)
    both = Installation(0.1, 0.2)
    assert np.cos(both.angle) == pytest.approx((np.trace(both.pose) - 1.0) / 2.0)
