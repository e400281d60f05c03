"""When a window is told as the drive that it was, and when a turn's refusal stands."""

import math
from dataclasses import replace

import numpy as np
import pytest
from honesty_cases import draw_case
from long_form import first_of
from realistic_robots import by_turn, collected, drawn, motors, stop_and_go
from realistic_robots import heading_error as turn_error
from simulated.drive import random_vehicle
from simulated.legs import circles, joined, standing
from smoothing.streets import BOSTON, driven, heading_error

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.calibrate import calibrate, calibrate_by, calibrate_drive, drive_instead
from magcal_ros.core.calibration.heading_sigma import predicted_heading_sigma, rms_apart
from magcal_ros.core.errors import Reason
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoothing.log import log_of

TURN = "maximum_likelihood"


@pytest.fixture(scope="module")
def ringed():
    """A robot that drives circles, and what it sees of them; nothing of the stand before them."""
    vehicle = random_vehicle(np.random.default_rng(7))
    robot = replace(vehicle.robot, gyro_bias=np.radians([0.1, 0.0, 0.1]))
    legs = joined(standing(5.0), circles(80.0, 4.0, 8.0))
    drive = driven(10, legs=legs, vehicle=replace(vehicle, robot=robot))
    rows = drive.time > drive.time[0] + 10.0
    return robot, Window(drive.time[rows], drive.field[rows], drive.force[rows], drive.rate[rows])


def nineteen_seconds(window, start):
    since = window.time - window.time[0] - start
    return window.take((since >= 0.0) & (since < 19.0))


@pytest.fixture(scope="module")
def short(ringed):
    """What the turn's model alone and the default make of nineteen seconds of the circles."""
    piece = nineteen_seconds(ringed[1], 0.0)
    return piece, calibrate_by(piece, BOSTON, TURN), calibrate(piece, BOSTON)


@pytest.mark.nightly
def test_circles_that_a_turn_cannot_tell_are_told_as_the_drive_they_were(ringed):
    robot, window = ringed
    turn, outcome = calibrate_by(window, BOSTON, TURN), calibrate(window, BOSTON)
    assert not turn.verdict.accepted
    assert outcome.verdict.accepted
    assert outcome.estimate.method == "smoother"
    error = heading_error(outcome.estimate.correction, robot)
    assert error < 0.3 * heading_error(turn.estimate.correction, robot)
    assert error < 2.0 * math.degrees(predicted_heading_sigma(outcome.estimate, 0.0))


def holds(robot, turn, outcome):
    """A turn is refused, and the drive is answered within what it predicts."""
    sigma = math.degrees(predicted_heading_sigma(outcome.estimate, 0.0))
    return (
        not turn.verdict.accepted
        and outcome.verdict.accepted
        and heading_error(outcome.estimate.correction, robot) < 2.0 * sigma < 10.0
    )


def test_nineteen_seconds_of_circles_are_enough_for_a_drive(ringed, short):
    _, turn, outcome = short
    assert holds(ringed[0], turn, outcome)
    assert outcome.estimate.method == "smoother"


@pytest.mark.nightly
def test_other_nineteen_seconds_are_enough_too(ringed):
    robot, window = ringed
    piece = nineteen_seconds(window, 30.0)
    assert holds(robot, calibrate_by(piece, BOSTON, TURN), calibrate(piece, BOSTON))


def test_a_gyro_that_is_far_off_is_no_matter_once_a_rest_has_shown_it(ringed):
    """Over a steady circle a bias looks like what pulls in it."""
    robot, whole = ringed
    window = nineteen_seconds(whole, 0.0)
    rate = window.angular_rate + np.radians([3.5, 2.0, 1.9])
    unknown = calibrate(replace(window, angular_rate=rate), BOSTON)
    known = calibrate(replace(window, sigma_before=5e-4), BOSTON)
    error = heading_error(known.estimate.correction, robot)
    sigma = math.degrees(predicted_heading_sigma(known.estimate, 0.0))
    assert known.verdict.accepted
    assert error < 2.0 * sigma
    assert sigma < 4.0
    assert error < 0.5 * heading_error(unknown.estimate.correction, robot)


def test_the_samples_of_the_answer_come_with_it(short):
    piece, turn, outcome = short
    assert len(outcome.window) == len(outcome.estimate.residual) < len(piece)
    assert turn.window is piece


def test_another_method_answers_alone(ringed):
    _, window = ringed
    assert calibrate(window, BOSTON, "design_tip").window is window


WRONG = {"upside down": 144, "gyro axes": 880, "large installation": 417, "iron beside": 35}
"""Turns on the spot, of the honesty benchmark, that a drive's model would have taken."""


@pytest.mark.parametrize("kind", first_of(WRONG))
def test_what_is_wrong_with_a_robot_is_not_driven_away(kind):
    _, case = draw_case(7, WRONG[kind])
    turn = calibrate_by(case.window, case.knowledge, TURN)
    assert not turn.verdict.accepted
    assert not calibrate(case.window, case.knowledge).verdict.accepted


def test_a_turn_on_the_spot_that_was_accepted_stays_a_turn():
    _, case = draw_case(7, 139)
    turn, log = calibrate_by(case.window, case.knowledge, TURN), log_of(case.window)
    assert log.stays
    assert turn.verdict.quality is Grade.WARN or turn.verdict.confidence is Grade.WARN
    # The drive's model says more than it knows there.
    drive = calibrate_drive(log, case.knowledge)
    assert predicted_heading_sigma(drive.estimate, 0.0) < predicted_heading_sigma(
        turn.estimate, 0.0
    )
    assert drive_instead(turn, log, case.knowledge) is turn


@pytest.mark.nightly
def test_an_uncertain_turn_without_a_jolt_stays_a_turn_though_its_gyro_looks_like_a_pull():
    """A cheap gyro, no rest: the drive is wrong by 11 degrees and says 3."""
    scene, known = by_turn("even", "cheap", "open")(10)
    turn, log = calibrate_by(scene.window, known, TURN), log_of(scene.window)
    assert turn.verdict.confidence is Grade.WARN
    assert not log.stays
    drive = calibrate_drive(log, known).estimate
    sigmas = [predicted_heading_sigma(each, 0.0) for each in (drive, turn.estimate)]
    assert sigmas[0] < sigmas[1]
    errors = [turn_error(scene, each.correction) for each in (drive, turn.estimate)]
    assert errors[0] > 3.0 * sigmas[0]
    assert errors[1] < 2.0 * sigmas[1]
    assert drive_instead(turn, log, known) is turn


def both(kind, number):
    """A turn on the spot of a robot with cheap sensors, no rest; as it was, and as a drive."""
    scene, known = by_turn(kind, "cheap", "open")(number)
    turn, log = calibrate_by(scene.window, known, TURN), log_of(scene.window)
    drive = calibrate_drive(log, known)
    assert turn.verdict.accepted
    assert drive.verdict.accepted
    assert log.jolts > 0.0085
    return scene, turn, drive, drive_instead(turn, log, known)


def test_a_drive_that_contradicts_a_rough_turn_is_not_taken():
    """Of a gyro whose bias passes for a pull along the road."""
    scene, turn, drive, answer = both("bent ground", 77)
    sigmas = [predicted_heading_sigma(each.estimate, 0.0) for each in (drive, turn)]
    assert sigmas[0] < sigmas[1]
    assert turn_error(scene, drive.estimate.correction) > 3.0 * sigmas[0]
    assert answer is turn
    assert turn_error(scene, turn.estimate.correction) < sigmas[1]


def test_what_a_drive_and_a_rough_turn_differ_by_stays_in_doubt():
    _, turn, drive, answer = both("there and back", 56)
    assert answer.estimate.method == "smoother"
    before, after = (predicted_heading_sigma(one.estimate, 0.0) for one in (drive, answer))
    field = turn.estimate.strength, turn.estimate.inclination
    gap = rms_apart(turn.estimate.correction, drive.estimate.correction, *field)
    assert after == pytest.approx(math.hypot(before, 0.5 * gap), rel=0.05)


def test_motors_that_a_rest_has_shown_are_not_driven_away():
    """Along the road a field that begins with the motors is that of a place which was left."""
    rng = np.random.default_rng([1, 2])
    scene, known = drawn(rng, stop_and_go)
    scene = motors(6e-6)(np.random.default_rng([2, 2]), scene)
    window = collected(scene.window)
    drive, outcome = calibrate_drive(log_of(window), known), calibrate(window, known)
    driven_error = turn_error(scene, drive.estimate.correction)
    error = turn_error(scene, outcome.estimate.correction)
    assert driven_error > 4.0 * predicted_heading_sigma(drive.estimate, 0.0)
    assert error < math.radians(0.5)
    assert "between rest and turn the field changes" in outcome.verdict.summary
    assert error < 2.0 * predicted_heading_sigma(outcome.estimate, 0.0)


@pytest.mark.parametrize("surer", first_of([True, False]))
def test_a_turn_gives_way_only_to_a_drive_that_is_surer_by_a_fifth(surer):
    """Circles that were driven; both models answer, and agree."""
    drawn = driven(1, legs=joined(standing(2.0), circles(60.0, 3.0, 6.0 if surer else 10.0)))
    window = Window(drawn.time, drawn.field, drawn.force, drawn.rate)
    turn, drive = calibrate_by(window, BOSTON, TURN), calibrate_drive(log_of(window), BOSTON)
    assert turn.verdict.accepted
    answer = drive_instead(turn, log_of(window), BOSTON).estimate
    sigmas = [predicted_heading_sigma(each.estimate, 0.0) for each in (drive, turn)]
    assert sigmas[1] > math.radians(2.0)
    assert (sigmas[0] < 0.8 * sigmas[1]) == surer
    assert answer.method == ("smoother" if surer else TURN)
    assert predicted_heading_sigma(answer, 0.0) <= (0.8 if surer else 1.0) * sigmas[1] + 1e-12
    assert heading_error(answer.correction, drawn.vehicle.robot) < 5.0


@pytest.mark.nightly
def test_a_drive_that_leans_the_sensor_where_the_turn_does_not_is_not_taken():
    """A gyro that is off by 7 °/s, which along the road is a sensor that leans by 20 degrees."""
    scene, turn, drive, answer = both("even", 73)
    assert "installation error" in drive.verdict.summary
    assert answer is turn
    errors = [turn_error(scene, each.estimate.correction) for each in (drive, turn)]
    assert errors[1] < 0.2 * errors[0]


@pytest.mark.parametrize("turned", first_of([("slope", 11), ("there and back", 8)]))
def test_a_turn_whose_gyro_is_bad_is_told_without_it(turned):
    """Nothing jolts, so nothing pulls; along the road the answer is five times less certain."""
    kind, number = turned
    scene, known = by_turn(kind, "cheap", "open")(number)
    assert calibrate_by(scene.window, known, TURN).reason is Reason.AXES_DISAGREE
    outcome, drive = calibrate(scene.window, known), calibrate_drive(log_of(scene.window), known)
    assert outcome.verdict.accepted
    assert "the turn that the gyro measured does not explain the samples" in outcome.verdict.summary
    sigmas = [predicted_heading_sigma(each.estimate, 0.0) for each in (outcome, drive)]
    errors = [turn_error(scene, each.estimate.correction) for each in (outcome, drive)]
    assert sigmas[0] < 0.25 * sigmas[1]
    assert errors[0] < min(2.0 * sigmas[0], 0.25 * errors[1])


@pytest.mark.parametrize("ned", [False, True], ids=["negative", "NED"])
def test_a_drive_by_an_accelerometer_that_is_upside_down_is_refused(ned):
    drive = driven(3, 150.0)
    sign = np.array([1.0, -1.0, -1.0]) if ned else -np.ones(3)
    window = Window(drive.time, drive.field, sign * drive.force, drive.rate)
    outcome = calibrate_drive(log_of(window), BOSTON)
    assert not outcome.verdict.accepted
    assert "z points down" in outcome.verdict.summary


def test_a_drive_whose_magnetometer_has_other_axes_is_refused_for_them():
    drive = driven(3)
    swapped = np.diag([1.0, -1.0, -1.0])
    outcomes = [
        calibrate_drive(log_of(Window(drive.time, field, drive.force, drive.rate)), BOSTON)
        for field in (drive.field, drive.field @ swapped)
    ]
    assert outcomes[0].verdict.accepted
    assert outcomes[1].reason is Reason.AXES_DISAGREE
    assert "axes" in outcomes[1].verdict.summary
