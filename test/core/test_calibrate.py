import math

import numpy as np
import pytest

from magcal_ros.core.calibrate import METHODS, calibrate, find_method
from magcal_ros.core.calibration import Calibration
from magcal_ros.core.simulator import DEGREE, LEVEL_TILT, Robot, heading_errors, measure, turn
from magcal_ros.core.verdict import Grade
from magcal_ros.core.window import Window

ROBOT = Robot()
TURN_METHODS = ("maximum_likelihood", "design_tip")
TUMBLE_METHODS = ("ellipsoid", "min_max")


def window_of(robot=ROBOT, **motion):
    return measure(robot, turn(**motion), np.random.default_rng(3), gyro=True)


def test_every_method_is_for_a_turn_or_for_a_tumbled_sensor():
    assert set(METHODS) == {*TURN_METHODS, *TUMBLE_METHODS}
    assert METHODS[0] == "maximum_likelihood"


@pytest.mark.parametrize("method", TUMBLE_METHODS)
def test_one_turn_is_too_little_for_a_method_that_wants_a_tumble(method):
    outcome = calibrate(window_of(), ROBOT.knowledge(), method)
    assert not outcome.verdict.accepted
    assert "plane" in outcome.verdict.summary


@pytest.mark.parametrize("method", TURN_METHODS)
class TestEveryMethod:
    def test_one_turn_calibrates_the_robot(self, method):
        outcome = calibrate(window_of(), ROBOT.knowledge(), method)
        assert outcome.verdict.accepted
        errors = heading_errors(outcome.calibration.correction, ROBOT)
        before = heading_errors(type(ROBOT.true_correction).identity(), ROBOT)
        assert math.degrees(np.sqrt(np.mean(errors[:, LEVEL_TILT] ** 2))) < 0.5
        assert math.degrees(np.sqrt(np.mean(before[:, LEVEL_TILT] ** 2))) > 20.0

    def test_the_calibration_carries_the_estimate_and_the_verdict(self, method):
        outcome = calibrate(window_of(), ROBOT.knowledge(), method)
        one, estimate, verdict = outcome.calibration, outcome.estimate, outcome.verdict
        assert one.correction is estimate.correction
        assert (one.covariance == estimate.covariance).all()
        assert (one.noise_field, one.noise_up) == (estimate.noise_field, estimate.noise_up)
        assert (one.strength, one.inclination) == (estimate.strength, estimate.inclination)
        evidence = one.evidence
        assert (evidence.method, evidence.quality) == (estimate.method, verdict.quality.value)
        assert (evidence.confidence, evidence.summary) == (
            verdict.confidence.value,
            verdict.summary,
        )
        assert evidence.reasons == tuple(check.words for check in verdict.checks)
        assert evidence.not_shown == verdict.not_shown
        assert evidence.figures == estimate.figures
        assert not evidence.accepted_by_user

    @pytest.mark.parametrize("motion", [{"arc": 0.0}, {"samples": 3}, {"arc": 10 * DEGREE}])
    def test_samples_that_cannot_carry_it_are_a_verdict_not_an_exception(self, method, motion):
        outcome = calibrate(window_of(**motion), ROBOT.knowledge(), method)
        assert outcome.calibration is None
        assert outcome.estimate is None
        assert outcome.verdict.quality is outcome.verdict.confidence is Grade.REFUSED
        assert outcome.verdict.summary.startswith("Refused: ")

    def test_a_window_without_samples_is_a_verdict(self, method):
        empty = Window(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))
        assert not calibrate(empty, ROBOT.knowledge(), method).verdict.accepted

    def test_a_bad_fit_is_refused_but_kept_for_who_insists(self, method):
        """A reference field that the samples contradict."""
        wrong = Robot(strength=90e-6).knowledge(strength_sigma=1e-6, inclination_sigma=0.01)
        outcome = calibrate(window_of(), wrong, method)
        assert not outcome.verdict.accepted
        assert isinstance(outcome.calibration, Calibration)


def test_a_refusal_names_the_unit_that_upset_the_fit():
    one = window_of()
    gauss = Window(one.time, 1e4 * one.field, one.specific_force, one.angular_rate)
    verdict = calibrate(gauss, ROBOT.knowledge()).verdict
    assert not verdict.accepted
    assert "looks like gauss" in verdict.summary


def test_the_first_method_is_the_default():
    outcome = calibrate(window_of(), ROBOT.knowledge())
    assert outcome.estimate.method == METHODS[0]


@pytest.mark.parametrize("name", ["", "os", "design-tip", "../estimate", "resampling"])
def test_only_methods_of_the_list_are_found(name):
    with pytest.raises(ValueError, match=f"choose one of {METHODS[0]}"):
        find_method(name)


class TestCalibration:
    def test_the_users_word_changes_nothing_but_the_mark(self):
        one = calibrate(window_of(), ROBOT.knowledge()).calibration
        told = one.on_users_word()
        assert told.evidence.accepted_by_user
        assert not one.evidence.accepted_by_user
        assert told.correction is one.correction
        assert told.evidence.summary == one.evidence.summary
        assert (told.covariance == one.covariance).all()
