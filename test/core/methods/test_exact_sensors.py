"""Sensors without errors but noise: the smoother's result of one turn is near the limit."""

import dataclasses
import functools
import math

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from long_form import first_of
from simulated.turns import Trouble, measure, smooth_wobble, turn

from magcal_ros.core import Figure, Knowledge, Mounting, SoftIron, Window
from magcal_ros.core.calibration import predicted_heading_sigma, yaw_jacobian
from magcal_ros.core.geometry import rotation_from_rpy
from magcal_ros.core.methods.smoother import METHOD, fit
from magcal_ros.core.simulation import (
    DEGREE,
    LEVEL_TILT,
    UP_ENU,
    Robot,
    heading_errors,
    trial_attitudes,
)

STILL = {"noise_field": 0.0, "noise_force": 0.0, "noise_rate": 0.0}
TILTED = np.array([0.0, 0.9, 0.9])


def rms_deg(estimate, robot, *, level=True):
    errors = heading_errors(estimate.correction, robot)
    return math.degrees(math.sqrt(np.mean((errors[:, LEVEL_TILT] if level else errors) ** 2)))


@pytest.mark.parametrize("gyro", [False, True])
@pytest.mark.parametrize("arc", first_of([90.0, 360.0, 200.0]))
@pytest.mark.parametrize("axis", first_of([TILTED, UP_ENU, np.array([0.5, -0.3, 0.8])]))
def test_without_noise_the_truth_is_found(axis, arc, gyro):
    robot = Robot(roll=20 * DEGREE, pitch=-30 * DEGREE, **STILL)
    motion = turn(arc=arc * DEGREE, samples=200, axis=axis, start_rpy=(0.0, 0.0, 0.7))
    window = measure(robot, motion, np.random.default_rng(1), gyro=gyro)
    estimate = fit(window, robot.knowledge())
    assert rms_deg(estimate, robot, level=False) < (2e-2 if gyro else 7e-3)
    assert estimate.arc == pytest.approx(arc * DEGREE, abs=2.5 * DEGREE)


def test_known_gains_and_pose_are_removed_first():
    mounting = Mounting(np.array([0.5, 1.2, 0.9]), rotation_from_rpy(math.pi, 0.1, 1.0))
    robot = Robot(mounting=mounting, **STILL)
    window = measure(robot, turn(start_rpy=(0.1, 0.0, 2.0)), np.random.default_rng(1), gyro=True)
    estimate = fit(window, robot.knowledge())
    assert rms_deg(estimate, robot, level=False) < 1e-2
    assert estimate.installation.roll == pytest.approx(robot.roll, abs=1e-4)
    assert estimate.installation.pitch == pytest.approx(robot.pitch, abs=1e-4)


@pytest.mark.parametrize(
    ("arc", "wobble", "limit", "seeds"),
    [
        (360.0, 5.0, 0.096, 1),
        *(
            pytest.param(*row, 24, marks=pytest.mark.nightly)
            for row in (
                (360.0, 0.0, 0.086),
                (180.0, 0.0, 0.097),
                (360.0, 5.0, 0.096),
                (180.0, 5.0, 0.098),
            )
        ),
    ],
)
def test_the_error_is_near_the_limit_and_predicted(arc, wobble, limit, seeds):
    robot, errors, ratios = Robot(), [], []
    for seed in range(seeds):
        rng = np.random.default_rng([5, seed])
        lean = smooth_wobble(rng, 500, 15.0, wobble * DEGREE) if wobble else None
        start = (0.0, 0.0, rng.uniform(-3.0, 3.0))
        motion = turn(arc=arc * DEGREE, start_rpy=start, wobble=lean)
        estimate = fit(measure(robot, motion, rng), robot.knowledge())
        errors.append(rms_deg(estimate, robot))
        ratios.append(heading_ratio(estimate, robot))
    assert math.sqrt(np.mean(np.square(errors))) < 1.7 * limit
    assert 0.4 < np.mean(ratios) < 2.0


@pytest.mark.nightly
@pytest.mark.parametrize(("wobble", "worst"), [(0.75, 0.1), (2.0, 0.03)])
def test_a_wobble_determines_the_axial_hard_iron_within_its_sigma(wobble, worst):
    robot, errors, ratios = Robot(), [], []
    for seed in range(10):
        rng = np.random.default_rng([21, seed])
        lean = smooth_wobble(rng, 500, 15.0, wobble * DEGREE)
        window = measure(
            robot, turn(start_rpy=(0.0, 0.0, rng.uniform(-3.0, 3.0)), wobble=lean), rng
        )
        reported = robot.knowledge(0.15 * robot.strength, 5.0 * DEGREE)
        estimate = fit(window, reported)
        error = estimate.correction.hard_iron[2] - robot.hard_iron[2]
        errors.append(error / robot.strength)
        ratios.append(error**2 / estimate.covariance[11, 11])
    assert math.sqrt(np.mean(np.square(errors))) < worst
    assert np.mean(ratios) < 2.5


def heading_ratio(estimate, robot):
    """Squared level heading error over its predicted variance."""
    poses = trial_attitudes()[:, LEVEL_TILT]
    jacobian = yaw_jacobian(estimate.correction, poses @ UP_ENU, poses @ robot.field_enu)
    variance = np.einsum("ki,ij,kj->k", jacobian, estimate.covariance, jacobian)
    return float(np.mean(heading_errors(estimate.correction, robot, poses) ** 2 / variance))


@pytest.mark.nightly
def test_unobservable_numbers_have_a_large_variance():
    robot = Robot()
    window = measure(robot, turn(start_rpy=(0.0, 0.0, 1.0)), np.random.default_rng(3), gyro=True)
    known = fit(window, robot.knowledge())
    unknown = fit(window, Knowledge())
    assert math.sqrt(known.covariance[11, 11]) < 0.5e-6
    assert math.sqrt(unknown.covariance[11, 11]) > 5e-6
    assert rms_deg(unknown, robot) < 0.4


@pytest.mark.parametrize("share", first_of([0.25, 0.1]))
def test_outliers_are_left_out(share):
    robot = Robot()
    trouble = Trouble(outliers=share, outlier_size=0.3 * robot.strength)
    window = measure(robot, turn(), np.random.default_rng(4), trouble=trouble)
    estimate = fit(window, robot.knowledge())
    assert rms_deg(estimate, robot) < 0.3


@pytest.mark.parametrize("size", first_of([0.03, 0.1, 0.3]))
def test_a_passing_disturbance_is_left_out(size):
    robot = Robot()
    trouble = Trouble(disturbance=size * robot.strength)
    window = measure(robot, turn(), np.random.default_rng(5), trouble=trouble)
    assert rms_deg(fit(window, robot.knowledge()), robot) < 0.3


@pytest.mark.nightly
@pytest.mark.parametrize("seed", first_of([30, 22, 24]))
def test_a_strong_disturbance_is_not_taken_for_soft_iron(seed):
    robot = Robot()
    trouble = Trouble(disturbance=0.3 * robot.strength)
    window = measure(robot, turn(), np.random.default_rng(seed), trouble=trouble)
    assert rms_deg(fit(window, robot.knowledge()), robot) < 0.5


@pytest.mark.nightly
def test_half_a_turn_of_a_robot_that_sways_strongly_is_near_the_limit():
    robot, rng = Robot(), np.random.default_rng(21)
    wobble = smooth_wobble(rng, 500, 15.0, 10 * DEGREE)
    motion = turn(arc=180 * DEGREE, samples=500, duration=15.0, wobble=wobble)
    assert rms_deg(fit(measure(robot, motion, rng), robot.knowledge()), robot) < 0.25


def distorted(iron):
    """A robot with such soft iron, and its turn."""
    robot = Robot(soft_iron=np.diag(iron))
    return robot, measure(robot, turn(), np.random.default_rng(6), gyro=True)


@functools.cache
def of_distorted(iron):
    robot, window = distorted(iron)
    return fit(window, robot.knowledge())


@pytest.mark.parametrize("iron", first_of([(0.05, -0.03, 0.0), (0.0, 0.0, 0.0)]))
def test_soft_iron_is_found_only_if_present(iron):
    robot, estimate = distorted(iron)[0], of_distorted(iron)
    assert rms_deg(estimate, robot) < 0.3
    gains = np.linalg.svd(estimate.correction.matrix)[1]
    assert gains.max() / gains.min() - 1.0 == pytest.approx(iron[0] - iron[1], abs=0.01)


def test_soft_iron_can_be_ruled_out():
    robot, window = distorted((0.0, 0.0, 0.0))
    ruled_out = dataclasses.replace(robot.knowledge(), soft_iron=SoftIron.none())
    assert of_distorted((0.0, 0.0, 0.0)).figures["soft_iron"] == 1.0
    assert fit(window, ruled_out).figures["soft_iron"] == 0.0


@pytest.mark.nightly
def test_a_gyro_improves_a_short_arc():
    robot = Robot()
    knowledge = robot.knowledge(0.03 * robot.strength, 2.0 * DEGREE)
    sigmas = {}
    for gyro in (False, True):
        window = measure(robot, turn(arc=60 * DEGREE), np.random.default_rng([8, 0]), gyro=gyro)
        sigmas[gyro] = predicted_heading_sigma(fit(window, knowledge), 0.0)
    assert sigmas[True] < sigmas[False]


@pytest.mark.nightly
def test_many_samples_are_averaged_without_loss():
    robot = Robot()
    window = measure(robot, turn(samples=8_000), np.random.default_rng(9))
    estimate = fit(window, robot.knowledge())
    assert rms_deg(estimate, robot) < 0.05
    assert estimate.inliers.shape == (8_000,)
    assert estimate.residual.shape == (8_000, 3)
    assert estimate.noise_field == pytest.approx(robot.noise_field, rel=0.15)


@pytest.mark.nightly
@examples(4)
@given(st.floats(-math.pi, math.pi))
def test_the_direction_of_north_does_not_matter(heading):
    robot = Robot(**STILL)
    window = measure(
        robot, turn(samples=60, start_rpy=(0.2, 0.1, heading)), np.random.default_rng(1)
    )
    assert rms_deg(fit(window, robot.knowledge()), robot, level=False) < 0.2


@pytest.mark.nightly
@examples(4)
@given(st.floats(-math.pi, math.pi))
def test_rotating_both_sensors_about_up_rotates_the_result(angle):
    robot = Robot(**STILL)
    window = measure(robot, turn(samples=60, start_rpy=(0.0, 0.0, 0.4)), np.random.default_rng(1))
    about = rotation_from_rpy(0.0, 0.0, angle)
    turned = Window(window.time, window.field @ about.T, window.specific_force @ about.T)
    plain, other = fit(window, robot.knowledge()), fit(turned, robot.knowledge())
    np.testing.assert_allclose(
        other.correction.hard_iron, about @ plain.correction.hard_iron, atol=1e-9
    )


def test_every_figure_is_explained():
    robot = Robot()
    window = measure(robot, turn(), np.random.default_rng(2), gyro=True)
    estimate = fit(window, robot.knowledge(1e-6, 0.02))
    assert estimate.method == METHOD
    assert all(isinstance(figure, Figure) for figure in estimate.figures)
    assert all(math.isfinite(value) for value in estimate.figures.values())
