import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from sample_results import SKEWED, estimate, small_covariance
from simulated.turns import measure, turn

from magcal_ros.core import Correction, Figure, Installation, Window
from magcal_ros.core.calibration import (
    arc_sigma,
    calibration_sigma,
    every_figure,
    predicted_heading_sigma,
    sideways_acceleration,
)
from magcal_ros.core.simulation import LEVEL_TILT, Robot, heading_errors

TRUTH = Robot()


def iron_only(sigma):
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = np.diag(np.square(sigma))
    return covariance


class TestPredictedHeadingSigma:
    def test_on_the_level_the_sigma_is_hard_iron_over_level_field(self):
        one = estimate(covariance=iron_only([0.4e-6, 0.4e-6, 9e-6]))
        assert predicted_heading_sigma(one, 0.0) == pytest.approx(0.4 / 25.0)

    def test_on_a_slope_the_axial_hard_iron_counts(self):
        tilt = math.radians(10.0)
        one = estimate(covariance=iron_only([0.0, 0.0, 3e-6]))
        assert predicted_heading_sigma(one, 0.0) == 0.0
        expected = 3.0 / 25.0 * math.sin(tilt) / math.sqrt(2.0)
        assert predicted_heading_sigma(one, tilt) == pytest.approx(expected, rel=0.02)

    def test_the_sigma_of_a_drive_includes_the_local_disturbance(self):
        one = estimate(covariance=iron_only([0.3e-6, 0.3e-6, 9e-6]))
        one = replace(one, figures={Figure.LOCAL_FIELD: 0.4e-6})
        assert predicted_heading_sigma(one) == pytest.approx(0.5 / 25.0)
        assert calibration_sigma(one) == pytest.approx(0.3 / 25.0)
        figures = every_figure(one)
        assert figures[Figure.LOCAL_SIGMA] == pytest.approx(0.4 / 25.0)
        assert figures[Figure.HEADING_SIGMA] == predicted_heading_sigma(one)

    def test_a_weakened_level_field_enlarges_the_effect_of_local_fields(self):
        weak = Correction(np.diag([4.0, 4.0, 1.0]), np.zeros(3))
        one = replace(
            estimate(correction=weak, covariance=np.zeros((12, 12))),
            figures={Figure.LOCAL_FIELD: 0.1e-6},
        )
        assert predicted_heading_sigma(one) == pytest.approx(0.4 / 25.0)

    @pytest.mark.parametrize("tilt", first_of([math.radians(10.0), 0.0]))
    def test_the_sigma_is_the_rms_error_of_drawn_corrections(self, tilt):
        covariance = small_covariance(of_matrix=3e-3, of_iron=0.1e-6)
        robot = Robot()
        truth = robot.true_correction
        one = estimate(correction=truth, covariance=covariance)
        drawn = np.random.default_rng(2).multivariate_normal(
            truth.parameters, covariance, 400, method="eigh"
        )
        errors = np.array([heading_errors(Correction.from_parameters(p), robot) for p in drawn])
        # roll and pitch in {-10, 0, 10}: the four with one of them zero lie around the level.
        poses = [LEVEL_TILT] if tilt == 0.0 else [1, 3, 5, 7]
        found = math.sqrt(float(np.mean(errors[:, :, poses] ** 2)))
        assert predicted_heading_sigma(one, tilt) == pytest.approx(found, rel=0.08)


@pytest.mark.parametrize("arc", [45.0, 90.0, 180.0, 360.0])
def test_iron_moves_the_ends_of_an_arc_apart_by_its_chord(arc):
    half = math.radians(0.5 * arc)
    one = estimate(covariance=iron_only([0.4e-6] * 3), arc=2.0 * half)
    assert arc_sigma(one) == pytest.approx(2.0 * math.sin(half) * 0.4 / 25.0, abs=1e-9)


def test_the_error_of_the_centre_along_the_middle_of_an_arc_counts():
    one = estimate(covariance=iron_only([0.4e-6, 0.0, 0.0]), arc=math.radians(90.0))
    assert arc_sigma(one) == pytest.approx(math.sqrt(2.0) * 0.4 / 25.0, rel=0.02)


class TestCommonFigures:
    def test_the_residual_is_that_of_inliers_over_the_level_field(self):
        residual = np.zeros((100, 3))
        residual[:80] = 0.5e-6
        residual[80:] = 40e-6
        inliers = np.arange(100) < 80
        figures = every_figure(estimate(residual=residual, inliers=inliers))
        assert figures["residual_ratio"] == pytest.approx(0.5 / 25.0)
        assert figures["outlier_share"] == pytest.approx(0.2)

    @pytest.mark.filterwarnings("ignore:Mean of empty slice", "ignore:invalid value")
    def test_without_inliers_the_residual_is_infinite(self):
        figures = every_figure(estimate(inliers=np.zeros(500, dtype=bool)))
        assert figures["residual_ratio"] == math.inf
        assert figures["outlier_share"] == 1.0

    def test_the_installation_angle_is_given_if_the_method_estimates_it(self):
        known = every_figure(estimate(installation=Installation(0.3, 0.0)))
        assert known["installation_angle"] == pytest.approx(0.3)
        assert "installation_angle" not in every_figure(estimate(installation=None))

    @pytest.mark.parametrize("ratio", [0.9, 1.1])
    def test_small_and_large_radii_have_the_same_misfit(self, ratio):
        figures = every_figure(estimate(figures={"radius_ratio": ratio}))
        assert figures["radius_misfit"] == pytest.approx(0.1)

    def test_a_circle_has_no_ellipse_excess(self):
        assert every_figure(estimate(figures={"ellipse_ratio": 1.0}))["ellipse_excess"] == 0.0
        assert "ellipse_excess" not in every_figure(estimate())
        assert "radius_misfit" not in every_figure(estimate())

    def test_the_sigmas_are_those_predicted(self):
        one = estimate(correction=SKEWED, covariance=small_covariance())
        figures = every_figure(one)
        assert figures["heading_sigma"] == predicted_heading_sigma(one, 0.0)
        tilted = predicted_heading_sigma(one, math.radians(10.0))
        assert figures["heading_sigma_tilted"] == tilted != figures["heading_sigma"]


class TestSidewaysAcceleration:
    @staticmethod
    def window(acceleration=0.0, **motion):
        one = measure(Robot(), turn(**motion), np.random.default_rng(3), gyro=True)
        force = one.specific_force + np.array([acceleration * 9.81, 0.0, 0.0])
        return Window(one.time, one.field, force, one.angular_rate)

    @pytest.mark.parametrize(
        "motion", [{}, {"arc": -math.tau}, {"start_rpy": (0.2, 0.1, 1.0)}, {"axis": [0.3, 0, 1.0]}]
    )
    def test_a_turn_on_the_spot_has_no_acceleration(self, motion):
        assert sideways_acceleration(self.window(**motion)) < math.radians(0.5)

    def test_a_circle_has_the_angle_of_its_acceleration(self):
        assert sideways_acceleration(self.window(0.1)) == pytest.approx(math.atan(0.1), abs=0.01)
