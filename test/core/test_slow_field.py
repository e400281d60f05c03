"""A field that comes more slowly than the IMU: all of the IMU's samples count."""

from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from realistic_robots import heading_error
from slow_fields import BEGUN, IMU_HZ, collected_at, drawn

from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.calibration.heading_sigma import predicted_heading_sigma
from magcal_ros.core.samples.window import SensorLog
from magcal_ros.core.simulation import DEGREE


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


def test_two_streams_of_it_have_the_same_integrals():
    scene, _ = drawn(np.random.default_rng(3), 0.3)
    window = collected_at(scene.window, 10.0)
    log = SensorLog.of_window(window)
    step = np.diff(log.imu_time)[:, None]
    velocity = np.cumsum(0.5 * step * (log.force[1:] + log.force[:-1]), axis=0)[1::2]
    np.testing.assert_allclose(velocity, np.cumsum(window.steps.velocity, axis=0), atol=1e-9)
    assert len(log.imu_time) == 2 * len(window) - 1


def test_nothing_is_inserted_where_no_imu_sample_was_left_out():
    scene, _ = drawn(np.random.default_rng(3), 0.3)
    window = collected_at(scene.window, IMU_HZ)
    left_out = int((window.missed.intervals > 1.0).sum())
    assert len(SensorLog.of_window(window).imu_time) == len(window) + left_out
    assert len(SensorLog.of_window(scene.window).imu_time) == len(scene.window)


def test_what_is_changed_of_a_window_counts():
    scene, _ = drawn(np.random.default_rng(3), 0.3)
    window = collected_at(scene.window, 10.0)
    bias = np.array([0.01, -0.02, 0.03])
    biased = replace(window, angular_rate=window.angular_rate + bias).steps.angle
    gained = np.diff(window.time)[:, None] * bias
    np.testing.assert_allclose(biased, window.steps.angle + gained, atol=1e-12)
