import dataclasses
import math

import numpy as np
import pytest
from drives import ROBOT
from long_form import first_of
from remembered import remembered
from simulated.turns import measure, smooth_wobble, turn

from magcal_ros.core import Grade, Knowledge, Reason, Refusal, calibrate
from magcal_ros.core.assessment import LEVEL_ONLY
from magcal_ros.core.calibration import heading_swing
from magcal_ros.core.monitoring import (
    NO_GYRO,
    ON_A_DRIVE,
    RECHECK_BOUNDS,
    STATES,
    expected_field,
    recheck,
)
from magcal_ros.core.simulation import Robot

pytestmark = pytest.mark.usefixtures("right_axes", "one_fit")

check = remembered(recheck.check)


def window(robot=ROBOT, seed=1, gyro=True, samples=700, duration=14.0, **motion):
    moved = turn(samples=samples, duration=duration, **motion)
    return measure(robot, moved, np.random.default_rng(seed), gyro=gyro)


@pytest.fixture(scope="module")
def calibration():
    return calibrate(window(), ROBOT.knowledge()).calibration


def moved(x=0.0, y=0.0, z=0.0, **changes):
    shift = np.array([x, y, z]) * 1e-6
    return dataclasses.replace(ROBOT, hard_iron=ROBOT.hard_iron + shift, **changes)


def figures(result):
    return {finding.figure.value: finding for finding in result.findings}


@pytest.mark.parametrize("gyro", [True, False])
@pytest.mark.parametrize("arc", first_of([math.tau, -math.tau, 4.0]))
def test_a_good_one_holds_on_a_fresh_turn(calibration, gyro, arc):
    result = check(window(seed=2, gyro=gyro, arc=arc), calibration)
    assert result.state == "holds", result.verdict.summary
    assert result.verdict.summary == "The calibration holds."
    assert ("gyro_compass_difference" in figures(result)) == gyro
    assert (NO_GYRO in result.verdict.not_shown) == (not gyro)


@pytest.fixture(scope="module")
def made_without_position():
    return calibrate(window(), Knowledge()).calibration


@pytest.mark.parametrize("stated", [(), (LEVEL_ONLY,)])
def test_one_made_without_a_position_holds_on_level_ground(made_without_position, stated):
    """A turn shows it by its sigma on slopes, a drive by what it does not determine."""
    made = made_without_position
    if stated:
        unseen = (*made.evidence.not_shown, *stated)
        covariance = made.covariance.copy()
        covariance[11], covariance[:, 11] = 0.0, 0.0
        evidence = dataclasses.replace(made.evidence, not_shown=unseen)
        made = dataclasses.replace(made, evidence=evidence, covariance=covariance)
    result = check(window(seed=2), made)
    assert result.state == "holds"
    assert result.verdict.summary == "The calibration holds on level ground."
    (slopes,) = [words for words in result.verdict.not_shown if "slopes" in words]
    assert "made without a position" in slopes
    assert ("or more" in slopes) is bool(stated)


@pytest.mark.parametrize("gyro", first_of([True, False]))
@pytest.mark.parametrize("shift", first_of([(5, 0), (0, -5), (-3.5, 3.5)]))
def test_a_hard_iron_change_of_5_ut_makes_it_stale(calibration, gyro, shift):
    result = check(window(moved(*shift), seed=3, gyro=gyro), calibration)
    assert result.state == "stale"
    found = figures(result)
    # 5 µT across a level field of 25 µT swing the heading by 11.5° at most, 8.1° rms.
    assert found["heading_swing"].value == pytest.approx(8.1, abs=0.5)
    assert "calibrate again" in result.verdict.summary
    if gyro:
        # The compass does not turn as the gyro does, but the calibration explains it.
        assert found["gyro_compass_difference"].value < 2.0


@pytest.mark.parametrize("gyro", [True, False])
def test_a_new_calibration_reduces_the_swing(calibration, gyro):
    for finding in check(window(seed=2, gyro=gyro), calibration).findings:
        assert finding.value < 0.5 * finding.before, finding


def test_hard_iron_along_the_axis_is_doubtful_and_no_heading_error(calibration):
    result = check(window(moved(z=5.0), seed=5), calibration)
    assert result.state == "doubtful"
    assert STATES[figures(result)["heading_swing"].grade] == "holds"
    assert STATES[figures(result)["strength_offset"].grade] == "doubtful"
    assert "doubtful" in result.verdict.summary


@pytest.mark.nightly
@pytest.mark.parametrize("gyro", first_of([True, False]))
@pytest.mark.parametrize(
    "change",
    first_of(
        [
            {"x": -4.0, "roll": ROBOT.roll - math.radians(4.0)},
            {"x": 3.0, "y": 2.0},
            {"pitch": ROBOT.pitch + math.radians(3.0)},
        ]
    ),
    ids=["both", "hard iron", "mounting"],
)
def test_the_swing_is_the_heading_error_of_the_old_calibration(calibration, change, gyro):
    robot = moved(**change)
    truth = robot.true_correction
    expected = heading_swing(truth, calibration.correction, robot.strength, robot.inclination)
    swing = figures(check(window(robot, seed=12, gyro=gyro), calibration))["heading_swing"]
    assert swing.value == pytest.approx(math.degrees(expected), abs=0.7)


@pytest.mark.parametrize("signs", first_of([(-1.0, -1.0, -1.0), (1.0, -1.0, -1.0)]))
def test_samples_of_another_sensor_are_stale(calibration, signs):
    """Its axes are turned or reversed: no small change of the calibration explains them."""
    clean = window(seed=13)
    result = check(dataclasses.replace(clean, field=clean.field * signs), calibration)
    assert result.state == "stale"
    assert "made for this robot and this sensor" in result.verdict.summary


def test_a_fit_that_refuses_the_axes_is_stale_with_its_reason(calibration, monkeypatch):
    """The field turns against the gyro, whatever the calibration."""

    def refuses(*_):
        raise Refusal(Reason.AXES_DISAGREE, "the field does not turn as the gyro does")

    monkeypatch.setattr(recheck.smoother, "check", refuses)
    result = recheck.check(window(seed=2), calibration)
    assert result.state == "stale"
    assert "no change of the calibration explains the samples" in result.verdict.summary
    assert "made for this robot" in result.verdict.summary


def test_a_distorted_room_is_no_fault_of_the_calibration(calibration):
    """The field still forms a circle, but its direction depends on the heading, as on a drive."""
    clean = window(seed=6)
    bent = clean.time * 0.0 + np.radians(15.0) * np.sin(np.linspace(0, math.tau, len(clean)))
    cosine, sine = np.cos(bent), np.sin(bent)
    body = calibration.correction.apply(clean.field)
    x, y = cosine * body[:, 0] - sine * body[:, 1], sine * body[:, 0] + cosine * body[:, 1]
    raw = calibration.correction.undo(np.column_stack([x, y, body[:, 2]]))
    result = check(dataclasses.replace(clean, field=raw), calibration)
    found = figures(result)
    # Of 10.6° RMS, a part is taken for a scale error of the gyro.
    assert 5.0 < found["gyro_compass_difference"].value < 11.0
    assert result.state == "holds"
    assert ON_A_DRIVE in result.verdict.not_shown


@pytest.mark.nightly
def test_a_steady_gyro_bias_is_no_fault(calibration):
    biased = moved(gyro_bias=np.radians([0.3, -0.2, 0.8]))
    result = check(window(biased, seed=7), calibration)
    assert result.state == "holds", result.verdict.summary


@pytest.mark.nightly
def test_an_extra_turn_of_the_compass_near_iron_is_no_fault(calibration):
    """Iron takes the level field away for a moment: the compass goes once round by itself."""
    clean = window(seed=7, samples=6000, duration=120.0, arc=4 * math.tau)
    body = calibration.correction.apply(clean.field)
    spin = np.interp(clean.time - clean.time[0], [20.0, 20.1], [0.0, math.tau])
    cosine, sine = np.cos(spin), np.sin(spin)
    x, y = cosine * body[:, 0] - sine * body[:, 1], sine * body[:, 0] + cosine * body[:, 1]
    raw = calibration.correction.undo(np.column_stack([x, y, body[:, 2]]))
    result = check(dataclasses.replace(clean, field=raw), calibration)
    assert result.state == "holds", result.verdict.summary


@pytest.mark.nightly
def test_wobble_and_vibration_are_no_fault(calibration):
    wobble = smooth_wobble(np.random.default_rng(8), 700, 14.0, math.radians(4.0))
    shaky = moved(noise_force=0.5)
    result = check(window(shaky, seed=8, wobble=wobble), calibration)
    assert result.state == "holds", result.verdict.summary


@pytest.mark.nightly
def test_gaps_and_several_turns_do_not_disturb_the_gyro_comparison(calibration):
    long = window(seed=9, samples=6000, duration=120.0, arc=9 * math.tau)
    keep = np.ones(len(long), dtype=bool)
    for first in (500, 1800, 3500):
        keep[first : first + 300] = False
    result = check(long.take(keep), calibration)
    assert result.state == "holds", result.verdict.summary


def test_a_turn_on_a_slope_is_judged_in_the_level_plane():
    """Installation known, so the slope itself is no fault."""
    robot = Robot(roll=0.0, pitch=0.0)
    level = calibrate(window(robot), robot.knowledge()).calibration
    slope = window(robot, seed=10, axis=np.array([0.0, 0.1, 1.0]))
    assert check(slope, level).state == "holds"


def test_another_field_strength_is_another_place(calibration):
    result = check(window(moved(strength=60e-6), seed=11), calibration)
    assert result.state == "stale"
    assert figures(result)["strength_offset"].value == pytest.approx(20.0, abs=1.0)


@pytest.mark.parametrize("bound", RECHECK_BOUNDS[:-1], ids=lambda bound: bound.figure.value)
def test_every_bound_grades_from_holds_to_stale(bound):
    cases = (0.99 * bound.good, 1.01 * bound.good, 1.01 * bound.warn, math.nan)
    found = [bound.check(value / bound.scale, before=0.0) for value in cases]
    assert [STATES[f.grade] for f in found] == ["holds", "doubtful", "stale", "stale"]
    assert "want" not in found[0].words
    assert bound.remedy in found[1].words


def test_the_keys_of_figures_are_unchanged(calibration):
    reported = {finding.key for finding in check(window(seed=2), calibration).findings}
    assert reported == {
        "heading_swing",
        "gyro_compass_rms",
        "strength_offset",
        "dip_offset",
    }


def test_a_part_of_a_turn_reduces_confidence_and_not_quality(calibration):
    verdict = check(window(seed=2, arc=3.0), calibration).verdict
    assert (verdict.quality, verdict.confidence) == (Grade.GOOD, Grade.WARN)
    assert verdict.accepted


def test_the_residual_is_the_noise_while_the_calibration_holds(calibration):
    result = check(window(seed=2), calibration)
    rms = float(np.sqrt(np.mean(result.estimate.residual**2)))
    assert rms == pytest.approx(ROBOT.noise_field, rel=0.35)


def test_a_changed_hard_iron_is_in_the_residual_and_refused(calibration):
    result = check(window(moved(5.0), seed=3), calibration)
    assert float(np.sqrt(np.mean(result.estimate.residual**2))) > 1.2e-6
    assert result.verdict.quality is Grade.REFUSED
    assert result.verdict.confidence is Grade.GOOD


def test_the_drawn_gyro_deviation_is_that_of_the_calibration(calibration):
    drawn = check(window(moved(5.0), seed=3), calibration).estimate.swing
    assert len(drawn.heading) == len(drawn.deviation)
    assert math.degrees(drawn.rms) == pytest.approx(8.1, abs=1.0)


def test_the_expected_field_has_the_strength_the_dip_and_the_heading_of_the_measured():
    up = np.tile([0.0, 0.0, 1.0], (5, 1))
    angles = np.linspace(0.0, 5.0, 5)
    field = np.stack([np.cos(angles), np.sin(angles), np.full(5, -3.0)], axis=-1)
    expected = expected_field(field, up, 2.0, math.radians(60.0))
    assert np.allclose(np.linalg.norm(expected, axis=1), 2.0)
    assert np.allclose(expected[:, 2], -2.0 * math.sin(math.radians(60.0)))
    assert np.allclose(
        np.arctan2(expected[:, 1], expected[:, 0]) - angles,
        np.round((np.arctan2(expected[:, 1], expected[:, 0]) - angles) / math.tau) * math.tau,
    )
