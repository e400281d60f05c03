import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from remembered import remembered
from simulated.turns import measure, slope_rpy, smooth_wobble, turn

from magcal_ros.core import (
    METHODS,
    Calibration,
    Grade,
    Knowledge,
    Mounting,
    Reason,
    Refusal,
    Window,
    calibrate,
)
from magcal_ros.core.calibrate import find_method
from magcal_ros.core.doctor import compare_axes, examine_window, with_explanation
from magcal_ros.core.geometry import rotation_from_rpy
from magcal_ros.core.simulation import DEGREE, LEVEL_TILT, Robot, heading_errors

ROBOT = Robot()
compare_once = remembered(compare_axes)
TURN_METHODS = ("maximum_likelihood", "design_tip")
TUMBLE_METHODS = ("ellipsoid", "min_max")


@pytest.fixture(autouse=True)
def one_look(monkeypatch):
    """Compare the axes of the same samples once: it takes longer than a fit."""
    monkeypatch.setattr("magcal_ros.core.doctor.motion.compare_axes", compare_once)


def window_of(robot=ROBOT, **motion):
    return measure(robot, turn(**motion), np.random.default_rng(3), gyro=True)


@functools.cache
def outcome_of(method):
    """The result of a whole turn."""
    return calibrate(window_of(), ROBOT.knowledge(), method)


def test_every_method_is_for_a_turn_a_drive_or_a_tumbled_sensor():
    assert set(METHODS) == {*TURN_METHODS, *TUMBLE_METHODS, "smoother", "smoother_one"}
    assert METHODS[0] == "maximum_likelihood"


@pytest.mark.parametrize("method", TUMBLE_METHODS)
def test_a_method_for_tumbles_refuses_a_turn(method):
    outcome = calibrate(window_of(), ROBOT.knowledge(), method)
    assert not outcome.verdict.accepted
    assert "plane" in outcome.verdict.summary


@pytest.mark.parametrize("method", TURN_METHODS)
class TestEveryMethod:
    def test_one_turn_calibrates_the_robot(self, method):
        outcome = outcome_of(method)
        assert outcome.verdict.accepted
        errors = heading_errors(outcome.calibration.correction, ROBOT)
        before = heading_errors(type(ROBOT.true_correction).identity(), ROBOT)
        assert math.degrees(np.sqrt(np.mean(errors[:, LEVEL_TILT] ** 2))) < 0.5
        assert math.degrees(np.sqrt(np.mean(before[:, LEVEL_TILT] ** 2))) > 20.0

    def test_the_calibration_has_the_estimate_and_the_verdict(self, method):
        outcome = outcome_of(method)
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
        used = {
            "reference_strength": ROBOT.strength,
            "reference_inclination": ROBOT.inclination,
        }
        assert evidence.figures == {**estimate.figures, **used}
        assert not evidence.accepted_by_user

    @pytest.mark.parametrize(
        "motion", [{"arc": 0.0}, {"samples": 3}, {"samples": 100, "arc": 10 * DEGREE}]
    )
    def test_insufficient_samples_give_a_verdict_and_no_exception(self, method, motion):
        outcome = calibrate(window_of(**motion), ROBOT.knowledge(), method)
        assert not outcome.verdict.accepted
        assert outcome.verdict.confidence is Grade.REFUSED
        assert outcome.verdict.summary.startswith("Refused")

    def test_a_window_without_samples_gives_a_verdict(self, method):
        empty = Window(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))
        assert not calibrate(empty, ROBOT.knowledge(), method).verdict.accepted


@pytest.mark.parametrize("method", first_of(TURN_METHODS))
def test_a_bad_fit_is_refused_but_kept_for_acceptance_by_hand(method):
    """A reference field that the samples contradict."""
    wrong = Robot(strength=20e-6).knowledge(strength_sigma=1e-6, inclination_sigma=0.01)
    outcome = calibrate(window_of(), wrong, method)
    assert not outcome.verdict.accepted
    assert isinstance(outcome.calibration, Calibration)


def test_less_than_a_quarter_turn_is_refused_but_can_be_accepted_by_hand():
    outcome = calibrate(window_of(arc=math.radians(57.0)), ROBOT.knowledge())
    assert outcome.calibration is not None
    assert not outcome.verdict.accepted
    assert "the turn covers 56.9° (want 90° or more)" in outcome.verdict.summary


def test_a_refusal_names_the_wrong_unit():
    one = window_of()
    gauss = Window(one.time, 1e4 * one.field, one.specific_force, one.angular_rate)
    verdict = calibrate(gauss, ROBOT.knowledge()).verdict
    assert not verdict.accepted
    assert "looks like gauss" in verdict.summary


@pytest.mark.parametrize("case", first_of([(0.1, True), (1.0, False), (3.0, False)]))
def test_all_methods_agree_on_when_gravity_is_absent(case):
    """A force in g is weak, and still shows the direction of up."""
    size, absent = case
    one = window_of()
    weak = Window(one.time, one.field, size / 9.80665 * one.specific_force)
    for method in METHODS:
        words = calibrate(weak, ROBOT.knowledge(), method).verdict.summary
        assert ("shows no gravity" in words) == absent, method


@pytest.mark.parametrize("described", [True, False])
def test_an_imu_upside_down_calibrates_where_the_description_says_so(described):
    window = window_of()
    turned = rotation_from_rpy(math.pi, 0.0, 0.5)  # the axes of the IMU to those of the robot
    upward = turned[2] if described else np.array([0.0, 0.0, 1.0])
    mounting = Mounting(pose=turned.T, upward=upward)
    force, rate = window.specific_force @ turned, window.angular_rate @ turned
    window = replace(window, specific_force=force, angular_rate=rate)
    knowledge = replace(ROBOT.knowledge(), mounting=mounting)
    outcome = calibrate(window, knowledge)
    assert outcome.verdict.accepted == described
    named = [each for each in examine_window(window, knowledge).findings if each.is_wrong]
    assert any("upside" in each.remedy or "z points down" in each.remedy for each in named) != (
        described
    )
    refusal = Refusal(Reason.FIELD_TOO_STEEP, "steep")
    assert (with_explanation(refusal, window, mounting) is refusal) == described
    found = outcome.calibration.correction
    in_robot = replace(found, matrix=turned @ found.matrix)
    errors = heading_errors(in_robot, ROBOT)
    assert math.degrees(np.sqrt(np.mean(errors[:, LEVEL_TILT] ** 2))) < 0.5


@pytest.mark.parametrize(("z", "reported"), [(-9.81, True), (9.81, False)])
def test_a_refusal_that_axes_may_have_caused_names_them(z, reported):
    force = np.full((5, 3), [0.0, 0.0, z])
    one = Window(np.arange(5.0), np.full((5, 3), 30e-6), force)
    steep = Refusal(Reason.FIELD_TOO_STEEP, "at an inclination of 86 degrees")
    assert ("z points down" in str(with_explanation(steep, one))) == reported
    small = Refusal(Reason.TOO_FEW_SAMPLES, "too few")
    assert with_explanation(small, one) is small


def test_the_first_method_is_the_default():
    outcome = calibrate(window_of(), ROBOT.knowledge())
    assert outcome.estimate.method == METHODS[0]


@pytest.mark.parametrize("name", ["", "os", "design-tip", "../estimate", "resampling"])
def test_only_listed_methods_are_accepted(name):
    with pytest.raises(ValueError, match=f"choose one of {METHODS[0]}"):
        find_method(name)


class TestCalibration:
    def test_acceptance_by_the_user_changes_only_the_mark(self):
        one = outcome_of(METHODS[0]).calibration
        reported = one.accepted_by_person()
        assert reported.evidence.accepted_by_user
        assert not one.evidence.accepted_by_user
        assert reported.correction is one.correction
        assert reported.evidence.summary == one.evidence.summary
        assert (reported.covariance == one.covariance).all()


@pytest.mark.parametrize("gyro", [True, False])
@pytest.mark.parametrize("known", first_of([True, False]))
@pytest.mark.parametrize("dip", first_of([65.0, 78.0]))
def test_after_a_full_turn_on_its_side_an_upright_turn_is_asked_for(dip, known, gyro):
    robot = Robot(strength=55e-6, inclination=dip * DEGREE)
    lying = turn(axis=np.array([0.0, 1.0, 0.0]), start_rpy=(90.0 * DEGREE, 0.0, 0.0))
    window = measure(robot, lying, np.random.default_rng(1), gyro=gyro)
    verdict = calibrate(window, robot.knowledge() if known else Knowledge()).verdict
    assert not verdict.accepted
    assert "stand the robot upright" in verdict.summary
    assert "full circle" not in verdict.summary


@pytest.mark.nightly
def test_after_a_full_circle_no_further_circle_is_asked_for():
    robot = Robot(noise_field=3e-6, noise_force=1.5)
    window = measure(robot, turn(samples=40), np.random.default_rng(1))
    checks = calibrate(window, robot.knowledge(10e-6, 10.0 * DEGREE)).verdict.checks
    asked = [check.words for check in checks if "turn once more" in check.words]
    assert asked
    assert not [check.words for check in checks if "full circle" in check.words]


@pytest.mark.nightly
@pytest.mark.parametrize("gyro", [True, False])
def test_a_robot_that_leans_with_the_ground_shows_no_soft_iron(gyro):
    """It rolls by 6 degrees twice a turn: the raw ellipse is not by iron."""
    robot = Robot(noise_field=0.2e-6)
    angle = np.arange(500) * (math.tau / 500)
    lean = 6.0 * DEGREE * np.column_stack([np.cos(2 * angle), np.sin(2 * angle), 0.0 * angle])
    window = measure(robot, turn(wobble=lean), np.random.default_rng(1), gyro=gyro)
    outcome = calibrate(window, robot.knowledge(1.5e-6, 1.0 * DEGREE))
    assert outcome.verdict.is_good
    gains = np.linalg.svd(outcome.estimate.correction.matrix, compute_uv=False)
    assert gains.max() / gains.min() < 1.02


@pytest.mark.parametrize("is_told", first_of([True, False]))
def test_a_sensor_a_quarter_turn_off_its_pose_is_named_though_its_turn_fits_well(is_told):
    """The fit was good, and the heading 90° off: the search for wrong axes was skipped."""
    rng = np.random.default_rng(5)
    sway = smooth_wobble(rng, 576, 19.2, 1.0 * DEGREE, (0.2, 2.0))
    slope = slope_rpy(2.0 * DEGREE, 1.0, 2.0)
    turned = Mounting(pose=rotation_from_rpy(0.0, 0.0, 0.5 * math.pi))
    robot = Robot(mounting=Mounting() if is_told else turned, noise_force=0.05)
    motion = turn(arc=1.07 * math.tau, samples=576, duration=19.2, start_rpy=slope, wobble=sway)
    told = (robot.knowledge(1.5e-6, DEGREE).reference, turned) if is_told else ()
    outcome = calibrate(measure(robot, motion, rng, gyro=True), Knowledge(*told))
    assert not outcome.verdict.accepted
    assert f"mount_rpy_deg: [0.0, 0.0, {0.0 if is_told else 90.0}]" in outcome.verdict.summary
