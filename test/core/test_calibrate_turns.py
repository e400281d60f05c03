"""Turns with different tilts determine more than one; a contradicting turn is left out."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from slope_turns import (
    EAST,
    KNOWN,
    LEVEL,
    NORTH,
    ROBOT,
    SOUTH,
    UNKNOWN,
    WEST,
    window_on,
    windows_on,
)

from magcal_ros.core import Reason, calibrate, calibrate_turns
from magcal_ros.core.calibrate import pooled
from magcal_ros.core.errors import UsageError
from magcal_ros.core.simulation import heading_errors

pytestmark = pytest.mark.usefixtures("right_axes")

FOREIGN = replace(ROBOT, hard_iron=ROBOT.hard_iron + np.array([2.5e-6, 0.0, 0.0]))


def absolute_rms_deg(outcome, robot=ROBOT):
    errors = heading_errors(outcome.calibration.correction, robot)
    return math.degrees(math.sqrt(float(np.mean(errors**2))))


def fates_of(outcome):
    return [fate.joined for fate in outcome.multi_turn.turns]


@pytest.fixture(scope="module")
def mixed():
    """Two turns of one robot; between and after them another load, a copy, and a rest."""
    rng = np.random.default_rng(8)
    few = {"samples": 250, "gyro": True}
    level = window_on(LEVEL, rng, samples=200, gyro=True)
    east = window_on(EAST, rng, **few)
    other = window_on(NORTH, rng, FOREIGN, **few)
    stood = window_on(NORTH, rng, arc=1e-3, **few)
    return calibrate_turns([level, other, east, east.take(np.arange(50, 200)), stood], KNOWN)


@pytest.mark.nightly
def test_one_turn_gives_exactly_its_own_estimate():
    window = windows_on([LEVEL], 1, samples=250)[0]
    together, alone = calibrate_turns([window], KNOWN), calibrate(window, KNOWN)
    np.testing.assert_array_equal(
        together.calibration.correction.parameters, alone.calibration.correction.parameters
    )
    np.testing.assert_array_equal(together.calibration.covariance, alone.calibration.covariance)
    assert together.verdict == alone.verdict
    assert math.degrees(together.multi_turn.shown.installation_yaw) == pytest.approx(5.0, abs=0.1)


@pytest.mark.nightly
@pytest.mark.parametrize("knowledge", [UNKNOWN, KNOWN])
def test_sensors_without_noise_determine_everything(knowledge):
    iron = np.array([[0.03, 0.01, -0.02], [0.01, -0.02, 0.01], [-0.02, 0.01, 0.02]])
    robot = replace(
        ROBOT, soft_iron=iron, yaw=math.radians(-12.0), noise_field=1e-10, noise_force=1e-5
    )
    outcome = calibrate_turns(windows_on([LEVEL, EAST, NORTH, WEST], 3, robot), knowledge)
    assert absolute_rms_deg(outcome, robot) < 0.15
    np.testing.assert_allclose(
        outcome.calibration.correction.hard_iron, robot.hard_iron, atol=0.1e-6
    )
    assert outcome.estimate.installation.yaw == pytest.approx(robot.yaw, abs=3e-3)
    assert outcome.estimate.figures["soft_iron"] == 1.0


@pytest.mark.nightly
def test_heading_is_absolute_with_its_sigma():
    outcome = calibrate_turns(windows_on((LEVEL, EAST, NORTH), 101, samples=300), KNOWN)
    assert outcome.verdict.accepted
    off = outcome.estimate.installation.yaw - ROBOT.yaw
    assert abs(off) < 3.0 * outcome.estimate.figures["installation_yaw_sigma"]
    assert 0.1 < math.degrees(outcome.multi_turn.shown.absolute_level) < 0.4
    assert absolute_rms_deg(outcome) < 1.0


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("slopes", "bound"),
    [
        pytest.param((LEVEL, EAST, NORTH), 0.40, id="level and two ramps"),
        pytest.param((EAST, NORTH, WEST, SOUTH), 0.25, id="four ramps"),
    ],
)
def test_heading_is_absolute_with_a_correct_covariance(slopes, bound):
    squares, sigmas = [], []
    for seed in range(4):
        outcome = calibrate_turns(windows_on(slopes, 100 + seed), KNOWN)
        assert outcome.verdict.accepted
        squares.append(absolute_rms_deg(outcome) ** 2)
        off = outcome.estimate.installation.yaw - ROBOT.yaw
        sigmas.append(off / outcome.estimate.figures["installation_yaw_sigma"])
    assert math.sqrt(np.mean(squares)) <= bound
    assert np.mean(np.square(sigmas)) < 2.5
    level = math.degrees(outcome.multi_turn.shown.absolute_level)
    assert bound / 3.0 < level < bound


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(2))
def test_another_turn_never_increases_the_sigma(seed):
    rng = np.random.default_rng(seed)
    slopes = [[LEVEL, EAST, NORTH, WEST, SOUTH][k] for k in rng.permutation(5)[:3]]
    slopes.append(slopes[0])
    windows = windows_on(slopes, 200 + seed)
    outcomes = [calibrate_turns(windows[: k + 1], KNOWN) for k in range(len(windows))]
    for name in ("installation_yaw", "inclination", "absolute_level", "absolute_tilted"):
        sigmas = [getattr(outcome.multi_turn.shown, name) for outcome in outcomes]
        # The noise is estimated anew with each turn, to some percent.
        assert all(after < 1.1 * before for before, after in pairwise(sigmas))
    errors = [absolute_rms_deg(outcome) for outcome in outcomes]
    assert errors[-1] < 0.3 * errors[0]
    assert all(outcome.verdict.accepted for outcome in outcomes)


def test_the_installation_yaw_is_zero_unless_determined():
    flat = calibrate_turns(windows_on([LEVEL, LEVEL], 5, gyro=True), KNOWN)
    assert flat.estimate.installation.yaw == 0.0
    assert "installation_yaw_sigma" not in flat.estimate.figures
    assert any("yaw of the installation" in words for words in flat.verdict.not_shown)
    assert "the same tilt as before" in flat.multi_turn.turns[1].words


def test_the_installation_yaw_is_given_after_a_slope(mixed):
    assert mixed.estimate.figures["installation_yaw_sigma"] < math.radians(0.5)
    assert not any("yaw of the installation" in words for words in mixed.verdict.not_shown)
    assert "yaw " in mixed.verdict.summary


class TestContradictingTurns:
    def test_each_is_left_out_with_its_reason(self, mixed):
        assert fates_of(mixed) == [True, False, True, False, False]
        words = [fate.words for fate in mixed.multi_turn.turns]
        assert "contradicts the other turns" in words[1]
        assert words[3] == "it holds the same samples as turn 3"
        assert "did not turn" in words[4]
        assert absolute_rms_deg(mixed) < 1.0

    def test_residuals_are_those_of_the_last_turn_that_joined(self, mixed):
        assert mixed.multi_turn.newest == 2
        assert len(mixed.estimate.residual) == len(mixed.estimate.inliers) == 250

    @pytest.mark.nightly
    @pytest.mark.parametrize("place", [1, 0, 2])
    def test_a_turn_with_another_load_is_found_at_any_position(self, place):
        rng = np.random.default_rng(8)
        windows = [window_on(slope, rng) for slope in (LEVEL, EAST)]
        windows.insert(place, window_on(NORTH, rng, FOREIGN))
        outcome = calibrate_turns(windows, KNOWN)
        assert fates_of(outcome) == [k != place for k in range(3)]
        assert "contradicts the other turns" in outcome.multi_turn.turns[place].words
        assert absolute_rms_deg(outcome) < 1.0

    @pytest.mark.nightly
    def test_of_two_contradicting_turns_the_first_is_kept(self):
        rng = np.random.default_rng(9)
        outcome = calibrate_turns(
            [window_on(LEVEL, rng), window_on(EAST, rng, FOREIGN)], KNOWN, names=["a", "b"]
        )
        assert fates_of(outcome) == [True, False]
        assert outcome.verdict.accepted
        assert "Not joined: b: it contradicts the turn before" in outcome.multi_turn.in_words

    @pytest.mark.nightly
    def test_a_copy_is_left_out_and_reported(self):
        windows = windows_on([LEVEL, EAST], 10)
        part = windows[1].take(np.arange(100, 400))
        outcome = calibrate_turns([*windows, part, windows[0]], KNOWN)
        assert fates_of(outcome) == [True, True, False, False]
        assert outcome.multi_turn.turns[2].words == "it holds the same samples as turn 2"

    @pytest.mark.nightly
    def test_a_window_at_rest_is_left_out(self):
        windows = [
            *windows_on([LEVEL, EAST], 11),
            window_on(NORTH, np.random.default_rng(1), arc=1e-3),
        ]
        outcome = calibrate_turns(windows, KNOWN)
        assert fates_of(outcome) == [True, True, False]
        assert "did not turn" in outcome.multi_turn.turns[2].words

    def test_bad_turns_alone_are_refused_with_all_reasons(self):
        rng = np.random.default_rng(12)
        still = [window_on(LEVEL, rng, arc=1e-3) for _ in range(2)]
        outcome = calibrate_turns(still, KNOWN)
        assert outcome.reason is Reason.NO_MOTION
        assert outcome.calibration is None
        assert "turn 1: " in outcome.verdict.summary
        assert "turn 2: " in outcome.verdict.summary


@pytest.mark.nightly
def test_a_short_arc_improves_the_others():
    rng = np.random.default_rng(13)
    full = [window_on(LEVEL, rng), window_on(EAST, rng)]
    short = window_on(NORTH, rng, arc=math.radians(70.0), samples=100)
    assert calibrate(short, UNKNOWN).reason is Reason.ARC_TOO_SHORT
    before, after = calibrate_turns(full, UNKNOWN), calibrate_turns([*full, short], UNKNOWN)
    assert fates_of(after) == [True, True, True]
    assert after.multi_turn.shown.absolute_tilted < 0.8 * before.multi_turn.shown.absolute_tilted
    assert after.estimate.arc > 6.0


def test_turns_with_gyro_and_without_are_joined():
    rng = np.random.default_rng(14)
    windows = [window_on(EAST, rng), window_on(NORTH, rng, gyro=True)]
    outcome = calibrate_turns(windows, KNOWN)
    assert fates_of(outcome) == [True, True]
    assert absolute_rms_deg(outcome) < 1.0
    assert outcome.estimate.figures["gyro_carried"] == 1.0


@pytest.mark.nightly
def test_the_noisier_turn_weighs_less():
    rng = np.random.default_rng(15)
    loud = replace(ROBOT, noise_field=4.0 * ROBOT.noise_field, noise_force=4.0 * ROBOT.noise_force)
    windows = [window_on(LEVEL, rng), window_on(EAST, rng), window_on(NORTH, rng)]
    without = calibrate_turns(windows, KNOWN)
    with_it = calibrate_turns([*windows, window_on(WEST, rng, loud)], KNOWN)
    gain = with_it.multi_turn.shown.installation_yaw / without.multi_turn.shown.installation_yaw
    assert 0.8 < gain < 1.02
    assert absolute_rms_deg(with_it) < 1.0


def test_other_methods_pool_the_samples_or_refuse():
    windows = windows_on([LEVEL, EAST], 17)
    together = pooled(windows)
    assert len(together) == len(windows[0]) + len(windows[1])
    assert calibrate_turns(windows, KNOWN, "ellipsoid").multi_turn is None
    with pytest.raises(UsageError, match="takes one turn; maximum_likelihood joins"):
        calibrate_turns(windows, KNOWN, "design_tip")


@pytest.mark.nightly
def test_the_sigma_includes_constant_sensor_errors():
    iron = np.array([[0.004, 0.003, -0.002], [0.003, -0.005, 0.002], [-0.002, 0.002, 0.003]])
    robot = replace(ROBOT, soft_iron=iron)
    windows = windows_on([LEVEL, EAST, NORTH], 5, robot, gyro=True)
    real = replace(KNOWN, exact_sensors=False)
    outcome, assumed = calibrate_turns(windows, real), calibrate_turns(windows, KNOWN)
    sigmas = [each.multi_turn.shown.absolute_level for each in (outcome, assumed)]
    assert sigmas[0] > 1.2 * sigmas[1]
    assert math.radians(absolute_rms_deg(outcome, robot)) < 3.0 * sigmas[0]


def test_no_turns_and_too_few_names_are_named():
    with pytest.raises(UsageError, match="no turn"):
        calibrate_turns([], UNKNOWN)
    window = window_on(LEVEL, np.random.default_rng(1))
    with pytest.raises(UsageError, match="2 turns have 1 names"):
        calibrate_turns([window, window], UNKNOWN, names=["first"])


def test_empty_windows_are_pooled_to_a_refusal():
    empty = window_on(LEVEL, np.random.default_rng(1)).take(np.arange(0))
    outcome = calibrate_turns([empty, empty], UNKNOWN, "min_max")
    assert outcome.reason is Reason.TOO_FEW_SAMPLES
