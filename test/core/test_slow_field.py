"""A field at a lower rate than the IMU: all IMU samples are used."""

from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from realistic_robots import heading_error
from slow_fields import BEGUN, IMU_HZ, collected_at, drawn

from magcal_ros.core import Window, calibrate
from magcal_ros.core.calibration import predicted_heading_sigma
from magcal_ros.core.samples import SensorLog, Steps
from magcal_ros.core.simulation import DEGREE
from magcal_ros.core.smoother import nodes_of

pytestmark = pytest.mark.usefixtures("right_axes")


@pytest.mark.parametrize("field_hz", first_of([10.0, 20.0, 5.0, 2.0, 1.0]))
@pytest.mark.parametrize("seed", first_of([7, 8, 9]))
def test_a_robot_that_shakes_is_calibrated_by_a_slow_field(field_hz, seed):
    """By one sample of the gyro for each of the field it was refused: its angle was unknown."""
    scene, knowledge = drawn(np.random.default_rng(seed), 0.3)
    outcome = calibrate(collected_at(scene.window, field_hz), knowledge)
    assert outcome.verdict.accepted
    error = heading_error(scene, outcome.estimate.correction)
    assert error < min(0.6 * DEGREE, 3.0 * predicted_heading_sigma(outcome.estimate))


def test_the_path_follows_every_sample_of_the_gyro():
    scene, _ = drawn(np.random.default_rng(3), 0.3)
    window = collected_at(scene.window, 10.0)
    rows = np.round((window.time - BEGUN) * IMU_HZ).astype(int)
    truth = scene.motion.attitude[rows] @ scene.motion.attitude[rows[0]].T
    away = window.steps.attitude @ np.swapaxes(truth, 1, 2)
    assert np.abs(away - np.eye(3)).max() < 0.5 * DEGREE
    fewer = window.take(np.arange(0, len(window), 7))
    np.testing.assert_allclose(fewer.steps.attitude, window.steps.attitude[::7], atol=1e-9)


def test_both_kinds_of_streams_have_the_same_integrals():
    scene, _ = drawn(np.random.default_rng(3), 0.3)
    window = collected_at(scene.window, 10.0)
    log = SensorLog.of_window(window)
    step = np.diff(log.imu_time)[:, None]
    velocity = np.cumsum(0.5 * step * (log.force[1:] + log.force[:-1]), axis=0)[1::2]
    np.testing.assert_allclose(velocity, np.cumsum(window.steps.velocity, axis=0), atol=1e-9)
    assert len(log.imu_time) == 2 * len(window) - 1


def test_without_omitted_imu_samples_nothing_is_inserted():
    scene, _ = drawn(np.random.default_rng(3), 0.3)
    window = collected_at(scene.window, IMU_HZ)
    left_out = int((window.missed.intervals > 1.0).sum())
    assert len(SensorLog.of_window(window).imu_time) == len(window) + left_out
    assert len(SensorLog.of_window(scene.window).imu_time) == len(scene.window)


def test_a_changed_window_uses_its_changed_values():
    scene, _ = drawn(np.random.default_rng(3), 0.3)
    window = collected_at(scene.window, 10.0)
    bias = np.array([0.01, -0.02, 0.03])
    biased = replace(window, angular_rate=window.angular_rate + bias).steps.angle
    gained = np.diff(window.time)[:, None] * bias
    np.testing.assert_allclose(biased, window.steps.angle + gained, atol=1e-12)


def test_more_than_a_quarter_turn_between_samples_is_integrated():
    """Angles beyond a quarter were read as their supplement: the field seemed to turn back."""
    angle = np.array([[0.1, 0.0, 1.2], [0.0, 0.2, 2.4], [0.1, 0.1, -4.0]])
    steps = Steps(angle, np.zeros((3, 3)), np.ones(3))
    np.testing.assert_allclose(steps.over(np.arange(4)).angle, angle, atol=1e-9)
    scene, knowledge = drawn(np.random.default_rng(7), 0.3)
    window = collected_at(scene.window, 10.0)
    # The field is silent for a third of the turn, like a driver that hangs.
    time = window.time - BEGUN
    holed = window.take((time < 9.0) | (time > 16.0))
    assert np.linalg.norm(holed.steps.angle, axis=1).max() > 0.5 * np.pi
    outcome = calibrate(holed, knowledge)
    assert outcome.verdict.accepted
    error = heading_error(scene, outcome.estimate.correction)
    assert error < min(1.0 * DEGREE, 3.0 * predicted_heading_sigma(outcome.estimate))


def test_nothing_is_extrapolated_into_a_gap_of_the_imu():
    """By the samples of a shaking robot beside it, turns there were up to 90 degrees off."""
    rng = np.random.default_rng(5)
    time = 1.0 + 0.1 * np.arange(200.0)
    time = time[(time < 9.0) | (time > 10.0)]
    rate = 0.3 + rng.normal(0.0, 0.1, (len(time), 3))
    window = Window(time, rng.normal(0.0, 1e-6, (len(time), 3)), np.ones_like(rate), rate)
    nodes = nodes_of(window, np.eye(3))
    hole = int(np.argmax(nodes.seconds))
    assert nodes.seconds[hole] > 1.0
    away = nodes.angle[hole] - 0.3 * nodes.seconds[hole]
    assert (np.abs(away) < 4.0 * np.sqrt(nodes.unseen[hole]) + 0.05).all()
    assert np.abs(away).max() < 0.25


def test_samples_of_a_silent_imu_are_no_division_by_zero():
    rate, still = np.full((6, 3), 0.1), np.zeros((5, 3))
    steps = Steps(still, still, np.array([10.0, 0.0, 0.0, 10.0, 10.0]))
    window = Window(0.1 * np.arange(6.0), np.ones((6, 3)), np.ones((6, 3)), rate)
    window = window.with_steps(steps)
    nodes = nodes_of(window, np.eye(3))
    assert np.isfinite(nodes.angle).all()
    assert np.isfinite(nodes.unseen).all()
