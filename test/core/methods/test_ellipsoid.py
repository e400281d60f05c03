"""The ellipsoid method with sensors of known truth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from long_form import first_of
from simulated.turns import Trouble, measure, smooth_wobble, turn
from tip_turns import rms_deg
from tumbles import QUIET, SQUARE, hand_tumbling, tumble, tumbling, with_fields

from magcal_ros.core import Knowledge, Mounting, Reason, Refusal, Window, calibrate
from magcal_ros.core.calibration import predicted_heading_sigma
from magcal_ros.core.geometry import rotation_from_rpy
from magcal_ros.core.methods.ellipsoid import Options, fit
from magcal_ros.core.simulation import DEGREE, Robot, heading_errors
from magcal_ros.files import read_csv_folder

seeds = st.integers(0, 2**32 - 1)


def soft_iron(rng, size):
    half = rng.uniform(-size, size, (3, 3))
    return 0.5 * (half + half.T)


def refusal(window, knowledge=Knowledge(), **options):
    with pytest.raises(Refusal) as caught:
        fit(window, knowledge, options=Options(**options))
    return caught.value


@examples(15)
@given(seeds)
def test_any_square_sensor_is_found_exactly_without_noise(seed):
    rng = np.random.default_rng(seed)
    mounting = Mounting(rng.uniform(0.5, 2.0, 3), rotation_from_rpy(*rng.uniform(-3.0, 3.0, 3)))
    robot = replace(
        QUIET,
        hard_iron=rng.uniform(-100e-6, 100e-6, 3),
        soft_iron=soft_iron(rng, 0.15),
        mounting=mounting,
        inclination=rng.uniform(-1.2, 1.2),
    )
    estimate = fit(tumble(robot, seed, samples=200), robot.knowledge())
    truth = robot.true_correction
    np.testing.assert_allclose(estimate.correction.matrix, truth.matrix, atol=1e-6)
    np.testing.assert_allclose(estimate.correction.hard_iron, truth.hard_iron, atol=1e-11)
    assert estimate.inclination == pytest.approx(robot.inclination, abs=1e-6)
    assert estimate.strength == robot.strength
    assert estimate.installation is None
    assert estimate.inliers.all()


def test_without_the_strength_the_geometric_mean_radius_is_kept():
    robot = replace(QUIET, soft_iron=np.diag([0.1, -0.1, 0.05]))
    estimate = fit(tumble(robot), Knowledge())
    assert np.linalg.det(estimate.correction.matrix) == pytest.approx(1.0)
    scale = np.linalg.det(np.eye(3) + robot.soft_iron) ** (1.0 / 3.0)
    assert estimate.strength == pytest.approx(scale * robot.strength)
    assert rms_deg(heading_errors(estimate.correction, robot)) < 1e-5
    assert "radius_ratio" not in estimate.figures


def test_the_figures_give_centre_radii_and_axes():
    robot = replace(QUIET, soft_iron=np.diag([0.1, -0.1, 0.02]), hard_iron=[1e-6, 2e-6, 3e-6])
    figures = fit(tumble(robot), robot.knowledge()).figures
    assert [figures[f"centre_{name}"] for name in "xyz"] == pytest.approx([1e-6, 2e-6, 3e-6])
    radii = [figures[f"radius_{k}"] for k in (1, 2, 3)]
    assert sorted(radii) == pytest.approx([45e-6, 51e-6, 55e-6])
    longest = 1 + int(np.argmax(radii))
    assert abs(figures[f"axis_{longest}_x"]) == pytest.approx(1.0)
    assert figures["radii_ratio"] == pytest.approx(55.0 / 45.0)
    assert figures["sphere_extent"] > 0.95


@pytest.mark.parametrize("motion", first_of([tumbling, hand_tumbling]))
def test_the_predicted_errors_are_the_true_ones(motion):
    iron, iron_sigma, heading, heading_sigma = [], [], [], []
    for seed in range(15):
        window = tumble(SQUARE, seed, motion=motion)
        estimate = fit(window, SQUARE.knowledge())
        iron.append(estimate.correction.hard_iron - SQUARE.hard_iron)
        iron_sigma.append(np.sqrt(np.diag(estimate.covariance)[9:]))
        heading.append(heading_errors(estimate.correction, SQUARE)[:, 4])
        heading_sigma.append(predicted_heading_sigma(estimate, 0.0))
    rms = [float(np.sqrt(np.mean(np.square(v)))) for v in (iron, iron_sigma)]
    assert rms[0] < 0.08e-6
    assert 0.5 < rms[1] / rms[0] < 2.0
    assert rms_deg(heading) < 0.2
    assert 0.7 < rms_deg(heading_sigma) / rms_deg(heading) < 3.0


@pytest.mark.parametrize("motion", [tumbling, hand_tumbling])
def test_a_rotated_mounting_is_reported_and_not_corrected(motion):
    robot = Robot(roll=3.0 * DEGREE, pitch=-4.0 * DEGREE, yaw=2.0 * DEGREE)
    window = tumble(robot, motion=motion)
    estimate = fit(window, robot.knowledge())
    true = rms_deg(heading_errors(estimate.correction, robot)[:, 4])
    assert true > 4.0
    assert math.degrees(predicted_heading_sigma(estimate, 0.0)) == pytest.approx(true, rel=0.2)
    assert math.degrees(estimate.figures["misalignment"]) == pytest.approx(5.4, abs=0.5)
    verdict = calibrate(window, robot.knowledge(), "ellipsoid").verdict
    assert not verdict.accepted
    assert "rotated against the IMU" in verdict.summary


def test_the_verdict_names_what_was_not_checked():
    outcome = calibrate(tumble(), SQUARE.knowledge(), "ellipsoid")
    assert outcome.verdict.accepted
    assert any("mounting of the magnetometer" in item for item in outcome.verdict.not_shown)
    assert not any("yaw of the installation" in item for item in outcome.verdict.not_shown)
    assert "installation roll" not in outcome.verdict.summary


def test_noise_is_measured():
    estimate = fit(tumble(samples=2000), SQUARE.knowledge())
    # The samples show the field's noise along the radius only.
    assert estimate.noise_field == pytest.approx(SQUARE.noise_field, rel=0.1)
    assert 0.01 < estimate.noise_up < 0.03
    assert estimate.arc > 1.8 * math.pi


def test_outliers_are_found_and_left_out():
    rng = np.random.default_rng(3)
    window = tumble(seed=3)
    field = window.field.copy()
    # Along the radius: a sample that is shifted along the sphere cannot be told from a good one.
    field[::40] = SQUARE.hard_iron + (field[::40] - SQUARE.hard_iron) * rng.uniform(1.3, 2, (20, 1))
    estimate = fit(with_fields(window, field), SQUARE.knowledge())
    assert not estimate.inliers[::40].any()
    assert estimate.inliers.mean() > 0.97
    np.testing.assert_allclose(estimate.correction.hard_iron, SQUARE.hard_iron, atol=0.15e-6)


def test_a_sphere_ignores_soft_iron_and_an_aligned_ellipsoid_its_rotation():
    lean = np.array([[0.0, 0.1, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    robot = replace(QUIET, soft_iron=np.diag([0.1, -0.1, 0.0]) + lean)
    window = tumble(robot)
    sphere = fit(window, robot.knowledge(), options=Options("sphere")).correction.matrix
    np.testing.assert_allclose(sphere, sphere[0, 0] * np.eye(3), atol=1e-12)
    aligned = fit(window, robot.knowledge(), options=Options("aligned")).correction.matrix
    np.testing.assert_allclose(aligned, np.diag(np.diag(aligned)), atol=1e-12)
    assert np.ptp(np.diag(aligned)) > 0.1
    with pytest.raises(ValueError, match="cube"):
        Options("cube")


@pytest.mark.parametrize("inclination", [0.0, 60.0, 75.0])
@pytest.mark.parametrize("shape", ["rotated", "aligned", "sphere"])
def test_a_turn_about_one_axis_is_refused(inclination, shape):
    robot = replace(SQUARE, inclination=inclination * DEGREE)
    rng = np.random.default_rng(0)
    for start in ((0.0, 0.0, 0.0), (0.2, -0.1, 1.0), (0.8, 0.6, 0.0)):
        refused = refusal(measure(robot, turn(start_rpy=start), rng), shape=shape)
        assert refused.reason is Reason.PLANAR
        assert "Tumble" in str(refused)


def test_a_wobbling_turn_is_refused_or_has_a_large_sigma():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        wobble = smooth_wobble(rng, 500, 15.0, 10.0 * DEGREE)
        window = measure(SQUARE, turn(wobble=wobble), rng)
        assert not calibrate(window, SQUARE.knowledge(), "ellipsoid").verdict.accepted


def test_a_sensor_at_rest_is_refused():
    window = tumble()
    still = SQUARE.hard_iron + np.array([20e-6, 5e-6, -40e-6])
    noise = 0.2e-6 * np.random.default_rng(0).standard_normal((len(window), 3))
    assert refusal(with_fields(window, still + noise)).reason is Reason.NO_MOTION


def test_a_part_of_the_sphere_is_refused_with_the_missing_part():
    window = tumble(samples=4000)
    cap = window.take(window.field[:, 2] - SQUARE.hard_iron[2] > 0.2 * SQUARE.strength)
    refused = refusal(cap, SQUARE.knowledge())
    assert refused.reason is Reason.ARC_TOO_SHORT
    assert "upside down" in str(refused)


def test_samples_that_form_no_sphere_are_refused():
    window = tumble()
    noise = np.random.default_rng(0).standard_normal((len(window), 3))
    assert refusal(with_fields(window, 30e-6 * noise)).reason is Reason.NO_SOLUTION


def test_an_implausible_ellipsoid_is_refused():
    flat = replace(QUIET, mounting=Mounting([1.0, 1.0, 0.25]))
    refused = refusal(tumble(flat))
    assert refused.reason is Reason.NO_SOLUTION
    assert "4.0 times" in str(refused)
    fit(tumble(flat), flat.knowledge())


def test_too_few_samples_are_refused():
    assert refusal(tumble(samples=39)).reason is Reason.TOO_FEW_SAMPLES
    fit(tumble(samples=40))


def test_simulated_outliers_do_not_break_the_fit():
    rng = np.random.default_rng(5)
    window = measure(SQUARE, tumbling(rng), rng, trouble=Trouble(outliers=0.05))
    estimate = fit(window, SQUARE.knowledge())
    np.testing.assert_allclose(estimate.correction.hard_iron, SQUARE.hard_iron, atol=0.2e-6)


def tumbled_recording(folder):
    recording = read_csv_folder(folder)
    time, imu = recording.field[:, 0], recording.imu
    force = np.column_stack([np.interp(time, imu[:, 0], imu[:, k]) for k in (1, 2, 3)])
    return Window(time, recording.field[:, 1:], force)


@pytest.mark.parametrize("shape", first_of(["rotated", "aligned", "sphere"]))
def test_a_recorded_tumble_gives_the_bias_of_motion_capture(recording, shape):
    window = tumbled_recording(recording("broad05"))
    estimate = fit(window, options=Options(shape))
    off = estimate.correction.hard_iron - np.array([-0.14, 0.20, 0.39]) * 1e-6
    print(f"broad05 {shape}: off by {np.round(off * 1e6, 2)} microtesla")
    assert np.linalg.norm(off) < 1e-6
    assert math.degrees(estimate.inclination) == pytest.approx(69.6, abs=1.0)
    assert estimate.strength == pytest.approx(44.3e-6, rel=0.02)
