"""Gyro-propagated attitudes, and how its errors enter them, against integrated truth."""

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_ros.core.estimation.averaging import prepare
from magcal_ros.core.estimation.effects import Effect
from magcal_ros.core.estimation.gyro_path import (
    BIAS,
    SCALE,
    GyroErrors,
    gyro_path,
    sense_of_mounting,
)
from magcal_ros.core.geometry.rotations import exp_rotations, rotation_angle
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.rest import RestBeside
from magcal_ros.core.simulation.simulator import DEGREE, Robot, measure, smooth_wobble, turn
from magcal_ros.core.up import relative_attitudes

QUIET = Robot(noise_rate=0.0, gyro_bias=np.zeros(3))


def window_with_gyro(robot=QUIET, samples=400):
    rng = np.random.default_rng(1)
    lean = smooth_wobble(rng, samples, 15.0, 4 * DEGREE)
    return measure(robot, turn(samples=samples, wobble=lean), rng, gyro=True)


def widest(one, other):
    return max(rotation_angle(a @ b.T) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize(("part", "size"), [(BIAS, 1e-4), (SCALE, 1e-3)])
@pytest.mark.parametrize("axis", range(3))
def test_an_error_of_the_gyro_turns_the_attitudes_as_the_basis_says(part, size, axis):
    window = window_with_gyro()
    every = np.arange(len(window))
    path = gyro_path(window, every)
    error = size * np.eye(3)[axis]
    wrong = error if part is BIAS else error * window.angular_rate
    # What the gyro reads too much has to be taken off to come to the truth.
    spoilt = replace(window, angular_rate=window.angular_rate + wrong)
    errors = np.zeros(path.size)
    errors[part] = error
    spoilt_path = gyro_path(spoilt, every)
    turned = exp_rotations(spoilt_path.basis @ errors)
    corrected = spoilt_path.relative @ turned
    worst = max(rotation_angle(a @ b.T) for a, b in zip(corrected, path.relative, strict=True))
    without = max(
        rotation_angle(a @ b.T) for a, b in zip(spoilt_path.relative, path.relative, strict=True)
    )
    assert worst < 0.05 * without


def test_the_prior_is_of_bias_scale_drift_and_acceleration():
    known = GyroErrors(bias=0.01, scale=0.05, acceleration=0.2)
    window = window_with_gyro()
    path = gyro_path(window, np.arange(len(window)), known).with_acceleration()
    information = path.prior_information(1e-3)
    assert information.shape == (path.size, path.size)
    errors = np.zeros(path.size)
    errors[BIAS], errors[SCALE], errors[-3:] = [0.01, 0, 0], [0, 0.05, 0], [0, 0, 0.2]
    assert errors @ information @ errors == pytest.approx(3.0)
    assert path.bias_in_sigmas(errors) == pytest.approx(1.0)
    np.testing.assert_array_equal(path.found(errors, Effect.PULL), errors[-6:])
    by_rate = path.pace.swiftness[:, None] * errors[-3:]
    np.testing.assert_allclose(path.added(errors)[:, :3], by_rate, atol=1e-15)
    drift = np.zeros(path.size)
    drift[path.drifts] = np.random.default_rng(2).standard_normal(3 * path.knots)
    walk = np.sum(path.knot_steps(drift) ** 2) / (1e-3**2 * path.spacing)
    assert drift @ information @ drift == pytest.approx(walk)


def test_samples_that_were_left_out_do_not_spoil_the_path():
    window = window_with_gyro()
    whole = gyro_path(window, np.arange(len(window)))
    turned = relative_attitudes(window.time, window.angular_rate)
    rows = np.unique(np.random.default_rng(3).integers(0, len(window), 60))
    few, kept = window.take(rows), replace(window, turned=turned).take(rows)
    truth = whole.relative[rows] @ whole.relative[rows[0]].T
    blind, seeing = (gyro_path(each, np.arange(len(rows))).relative for each in (few, kept))
    assert widest(seeing, truth) < 1e-9
    assert widest(blind, truth) > 0.3 * DEGREE


def rested(window, **changes):
    still = RestBeside(3.0, np.ones(3), 1e-8, 9.81 * np.ones(3), np.zeros(3), 2e-4, 0.0, np.eye(3))
    return replace(window, rests=(replace(still, **changes),))


def test_a_rest_beside_the_turn_shows_the_bias_and_where_the_robot_stood():
    window, known = window_with_gyro(), GyroErrors()
    every = np.arange(len(window))
    path = gyro_path(rested(window, beside=window.time[-1]), every)
    assert path.known.bias == pytest.approx(math.hypot(known.rested_bias, 2e-4))
    assert gyro_path(window, every).known.bias == known.bias
    np.testing.assert_allclose(path.rests[0].relative, path.relative[-1], atol=1e-9)
    assert not path.rests[0].is_before


def test_stretches_are_averaged_to_rotations():
    window = window_with_gyro()
    path = gyro_path(window, np.arange(0, len(window), 4))
    identity = np.broadcast_to(np.eye(3), path.relative.shape)
    np.testing.assert_allclose(
        path.relative @ np.swapaxes(path.relative, 1, 2), identity, atol=1e-6
    )


@pytest.mark.parametrize(("roll_deg", "sense"), [(5.0, 1.0), (175.0, -1.0)])
def test_a_magnetometer_upside_down_is_seen(roll_deg, sense):
    robot = replace(QUIET, roll=roll_deg * DEGREE)
    window = measure(robot, turn(), np.random.default_rng(1), gyro=True)
    samples = prepare(window.field, window.specific_force, Knowledge(), 800).all
    assert sense_of_mounting(samples, gyro_path(window, np.arange(len(window)))) == sense
