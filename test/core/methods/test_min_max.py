"""The min/max method with sensors of known truth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from long_form import first_of
from simulated.turns import measure, smooth_wobble, turn
from tip_turns import rms_deg
from tumbles import QUIET, SQUARE, hand_tumbling, pole_window, tumble, tumbling, with_fields

from magcal_ros.core import Knowledge, Mounting, Reason, Refusal, Window, calibrate
from magcal_ros.core.calibration import predicted_heading_sigma
from magcal_ros.core.geometry import rotation_from_rpy
from magcal_ros.core.methods import samples_on_ellipsoid
from magcal_ros.core.methods.min_max import Options, fit
from magcal_ros.core.simulation import DEGREE, heading_errors

seeds = st.integers(0, 2**32 - 1)
ROBUST = Options(robust=True)


def refusal(window, knowledge=Knowledge(), **options):
    with pytest.raises(Refusal) as caught:
        fit(window, knowledge, options=Options(**options))
    return caught.value


@examples(20)
@given(seeds, st.booleans())
def test_offset_and_scale_are_exact_if_every_axis_was_along_the_field(seed, robust):
    rng = np.random.default_rng(seed)
    robot = replace(
        QUIET,
        hard_iron=rng.uniform(-100e-6, 100e-6, 3),
        mounting=Mounting(np.ones(3), rotation_from_rpy(*rng.uniform(-3.0, 3.0, 3))),
        soft_iron=np.diag(rng.uniform(-0.1, 0.1, 3)),
    )
    estimate = fit(pole_window(robot), robot.knowledge(), options=Options(robust=robust))
    truth = robot.true_correction
    np.testing.assert_allclose(estimate.correction.matrix, truth.matrix, atol=1e-9)
    np.testing.assert_allclose(estimate.correction.hard_iron, truth.hard_iron, atol=1e-13)
    assert estimate.installation is None


def test_without_the_strength_the_mean_of_the_half_ranges_is_kept():
    robot = replace(QUIET, soft_iron=np.diag([0.1, -0.1, 0.06]))
    estimate = fit(pole_window(robot), Knowledge())
    assert estimate.strength == pytest.approx(51e-6)
    corrected = estimate.correction.apply(pole_window(robot).field)
    np.testing.assert_allclose(np.abs(corrected[:6]).max(axis=1), 51e-6)
    assert estimate.figures["half_range_x"] == pytest.approx(55e-6)
    assert estimate.figures["offset_z"] == pytest.approx(robot.hard_iron[2])


def test_order_and_density_of_samples_do_not_matter():
    window = pole_window()
    plain = fit(window, QUIET.knowledge(), options=ROBUST).correction.parameters
    order = np.random.default_rng(1).permutation(len(window))
    mixed = Window(window.time, window.field[order], window.specific_force[order])
    again = fit(mixed, QUIET.knowledge(), options=ROBUST).correction.parameters
    np.testing.assert_array_equal(plain, again)
    rows = np.concatenate([np.arange(800), np.full(3000, 17)])
    crowded = Window(np.arange(3800.0), window.field[rows], window.specific_force[rows])
    found = fit(crowded, QUIET.knowledge(), options=ROBUST).correction.parameters
    np.testing.assert_array_equal(plain, found)


@pytest.mark.parametrize("motion", first_of([tumbling, hand_tumbling]))
def test_the_predicted_errors_are_not_too_small(motion):
    heading, sigma = [], []
    for seed in range(15):
        estimate = fit(tumble(SQUARE, seed, motion=motion), SQUARE.knowledge())
        heading.append(heading_errors(estimate.correction, SQUARE)[:, 4])
        sigma.append(predicted_heading_sigma(estimate, 0.0))
    assert 0.3 < rms_deg(heading) < 1.5
    assert 0.9 < rms_deg(sigma) / rms_deg(heading) < 3.0


def test_outliers_change_the_simple_extremes_but_not_the_robust_ones():
    window = tumble(seed=3)
    field = window.field.copy()
    field[::50] = SQUARE.hard_iron + 2.0 * (field[::50] - SQUARE.hard_iron)
    field[25] += np.array([150e-6, 80e-6, -60e-6])
    dirty = with_fields(window, field)
    refused = refusal(dirty, SQUARE.knowledge())
    assert "robust" in str(refused)
    estimate = fit(dirty, SQUARE.knowledge(), options=ROBUST)
    clean = fit(window, SQUARE.knowledge(), options=ROBUST)
    assert not estimate.inliers[::50].any()
    assert estimate.inliers.mean() > 0.97
    difference = estimate.correction.hard_iron - clean.correction.hard_iron
    assert np.abs(difference).max() < 0.5e-6


@pytest.mark.parametrize("share", [0.3, 0.6, 0.85])
def test_a_cluster_off_the_sphere_is_left_out(share):
    rng = np.random.default_rng(4)
    window = tumble(seed=4, samples=1200)
    count = int(share / (1.0 - share) * len(window))
    package = SQUARE.hard_iron + np.array([70e-6, 30e-6, 10e-6])
    package = package + 0.5e-6 * rng.standard_normal((count, 3))
    force = np.tile([0.0, 0.0, 9.81], (count, 1))
    n = len(window) + count
    mixed = Window(
        np.arange(float(n)),
        np.vstack([window.field, package]),
        np.vstack([window.specific_force, force]),
    )
    kept = samples_on_ellipsoid(mixed.field)
    assert kept[: len(window)].mean() > 0.97
    assert not kept[len(window) :].any()


def test_gravity_shows_a_rotated_mounting_and_the_verdict_what_was_not_checked():
    turned = replace(SQUARE, roll=6.0 * DEGREE)
    estimate = fit(tumble(turned), turned.knowledge())
    assert math.degrees(estimate.figures["misalignment"]) == pytest.approx(6.0, abs=0.7)
    assert not calibrate(tumble(turned), turned.knowledge(), "min_max").verdict.accepted
    verdict = calibrate(tumble(), SQUARE.knowledge(), "min_max").verdict
    assert verdict.accepted
    assert any("mounting of the magnetometer" in item for item in verdict.not_shown)


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("inclination", [0.0, 60.0, 75.0])
def test_a_turn_about_one_axis_is_refused(inclination, robust):
    robot = replace(SQUARE, inclination=inclination * DEGREE)
    rng = np.random.default_rng(0)
    for start in ((0.0, 0.0, 0.0), (0.2, -0.1, 1.0), (0.8, 0.6, 0.0)):
        refused = refusal(measure(robot, turn(start_rpy=start), rng), robust=robust)
        assert refused.reason is Reason.PLANAR
        assert "turns about one axis" in str(refused)


def test_a_turn_that_wobbles_is_refused():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        wobble = smooth_wobble(rng, 500, 15.0, 15.0 * DEGREE)
        refusal(measure(SQUARE, turn(wobble=wobble), rng), SQUARE.knowledge())


def test_an_axis_that_was_never_along_the_field_is_named():
    window = tumble(samples=4000)
    flat = window.take(np.abs(window.field[:, 1] - SQUARE.hard_iron[1]) < 0.4 * SQUARE.strength)
    refused = refusal(flat, SQUARE.knowledge())
    assert refused.reason is Reason.PLANAR
    assert "The y axis" in str(refused)


def test_half_a_sphere_is_refused():
    window = tumble(samples=4000)
    raised = window.field - SQUARE.hard_iron
    half = window.take(raised @ [1.0, 1.0, 1.0] > 0.0)
    reason = refusal(half, SQUARE.knowledge()).reason
    assert reason in (Reason.ARC_TOO_SHORT, Reason.NO_SOLUTION)


def test_a_sensor_at_rest_and_too_few_samples_are_refused():
    window = tumble()
    still = SQUARE.hard_iron + np.array([20e-6, 5e-6, -40e-6])
    noise = 0.2e-6 * np.random.default_rng(0).standard_normal((len(window), 3))
    assert refusal(with_fields(window, still + noise)).reason is Reason.NO_MOTION
    assert refusal(tumble(samples=39)).reason is Reason.TOO_FEW_SAMPLES
