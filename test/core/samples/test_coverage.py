import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated.turns import measure, smooth_wobble, turn

from magcal_ros.core import Mounting
from magcal_ros.core.geometry import rotation_about, rotation_from_rpy
from magcal_ros.core.samples import BINS, Coverage, thin_to_equal_angles, yaw_progress
from magcal_ros.core.simulation import DEGREE, Robot

ROBOT = Robot()
SOUTH_OF_THE_EQUATOR = Robot(inclination=-60 * DEGREE)
STRONG_IRON = Robot(hard_iron=np.array([120e-6, -80e-6, 200e-6]))
ASKEW = Robot(roll=30 * DEGREE, pitch=-33 * DEGREE)


def sweep(first_deg, last_deg, step_deg=2.0):
    return np.radians(np.arange(first_deg, last_deg + 0.5 * step_deg, step_deg))


class TestCoverage:
    def test_nothing_is_covered_before_the_first_samples(self):
        for coverage in (Coverage.nothing(), Coverage.of(np.zeros(0)), Coverage.of(np.zeros(1))):
            assert coverage.arc == coverage.turned == 0.0
            assert coverage.gap == pytest.approx(math.tau)
            assert not coverage.is_complete
            assert coverage.hole_in_words == "the robot has not turned yet"

    @given(st.floats(6.0, 350.0), st.sampled_from([-1.0, 1.0]), st.floats(-720.0, 720.0))
    def test_arc_and_gap_do_not_depend_on_the_start(self, arc, sense, start):
        progress = np.radians(start + sense * np.linspace(0.0, arc, 400))
        coverage = Coverage.of(progress)
        assert math.degrees(coverage.arc) == pytest.approx(arc, abs=1e-6)
        assert math.degrees(coverage.gap) == pytest.approx(360.0 - arc, abs=1e-6)
        assert math.degrees(coverage.turned) == pytest.approx(sense * arc, abs=1e-6)

    @pytest.mark.parametrize(("last", "arc"), [(358.0, 360.0), (350.0, 350.0)])
    def test_the_spacing_of_samples_is_no_gap(self, last, arc):
        assert math.degrees(Coverage.of(sweep(0.0, last)).arc) == pytest.approx(arc)

    @given(st.lists(st.floats(-50.0, 50.0), min_size=2, max_size=60))
    def test_repetition_and_order_do_not_change_the_arc(self, headings):
        once = Coverage.of(np.array(headings))
        again = Coverage.of(np.array(headings[::-1] + headings))
        assert again.arc == pytest.approx(once.arc)
        assert (again.filled == once.filled).all()

    @given(st.lists(st.floats(-50.0, 50.0), min_size=2, max_size=60))
    def test_the_gap_contains_no_heading(self, headings):
        coverage = Coverage.of(np.array(headings))
        away = np.remainder(np.array(headings) - coverage.gap_centre + math.pi, math.tau) - math.pi
        assert np.abs(away).min() >= 0.5 * coverage.gap - 1e-9

    def test_bins_count_from_the_start_to_the_left(self):
        filled = Coverage.of(sweep(1.0, 29.0)).filled
        assert filled.tolist() == [True] * 3 + [False] * (BINS - 3)
        assert Coverage.of(sweep(-29.0, -1.0)).filled.tolist() == [False] * 33 + [True] * 3

    @pytest.mark.parametrize(
        ("last", "step", "complete"),
        [
            (358.0, 2.0, True),
            (341.0, 1.0, True),
            (339.0, 1.0, False),
            (355.0, 9.0, True),
            (351.0, 13.0, True),
        ],
    )
    def test_complete_means_no_gap_over_20_degrees(self, last, step, complete):
        assert Coverage.of(sweep(0.0, last, step)).is_complete == complete

    def test_a_gap_in_the_middle_makes_a_turn_incomplete(self):
        progress = np.concatenate([sweep(0.0, 100.0), sweep(125.0, 380.0)])
        assert not Coverage.of(progress).is_complete
        assert Coverage.of(np.append(progress, np.radians(113.0))).is_complete

    @pytest.mark.parametrize(
        ("first", "last", "words"),
        [
            (0.0, 180.0, "missing: 180°, centred 90° to the right of the start"),
            (-180.0, 0.0, "missing: 180°, centred 90° to the left of the start"),
            (0.0, 270.0, "missing: 90°, centred 45° to the right of the start"),
            (-270.0, 0.0, "missing: 90°, centred 45° to the left of the start"),
            (-150.0, 150.0, "missing: 60° opposite the start"),
            (0.0, 358.0, ""),
            (0.0, 4.0, "the robot has not turned yet"),
        ],
    )
    def test_the_words_name_the_gap(self, first, last, words):
        assert Coverage.of(sweep(first, last)).hole_in_words == words

    @pytest.mark.parametrize("hole", [90.0, -90.0])
    def test_filling_the_named_gap_completes_the_turn(self, hole):
        """Left of the start is counter-clockwise."""
        seen = sweep(hole + 40.0, hole + 320.0)
        side = "left" if hole > 0.0 else "right"
        assert f"centred 90° to the {side}" in Coverage.of(seen).hole_in_words
        filled = np.concatenate([seen, sweep(hole - 40.0, hole + 40.0)])
        assert Coverage.of(filled).is_complete


def progress_of(robot, motion, gyro, seed=1):
    window = measure(robot, motion, np.random.default_rng(seed), gyro=gyro)
    nominal = np.linalg.inv(robot.mounting.matrix)
    field = window.field @ nominal.T
    return yaw_progress(window.time, field, window.specific_force, window.angular_rate)


class TestYawProgressOfATurn:
    @pytest.mark.parametrize("robot", [ROBOT, SOUTH_OF_THE_EQUATOR, STRONG_IRON, ASKEW])
    @pytest.mark.parametrize("gyro", [False, True])
    @pytest.mark.parametrize("sense", [-1.0, 1.0])
    @pytest.mark.parametrize("arc", [120.0, 200.0, 360.0, 700.0])
    def test_the_progress_follows_the_turn(self, robot, gyro, sense, arc):
        motion = turn(arc=sense * arc * DEGREE, samples=600, duration=20.0)
        progress = progress_of(robot, motion, gyro)
        truth = sense * arc * DEGREE * motion.time / 20.0
        assert progress[0] == 0.0
        assert np.abs(np.degrees(progress - truth)).max() < 10.0
        assert math.degrees(progress[-1]) == pytest.approx(sense * arc, abs=6.0)

    @pytest.mark.parametrize("angle", [15.0, 30.0, 45.0])
    @pytest.mark.parametrize("side", range(8))
    @pytest.mark.parametrize("sense", [-1.0, 1.0])
    def test_the_sense_is_correct_for_installations_up_to_45_degrees(self, angle, side, sense):
        lean = angle * DEGREE * np.exp(1j * side * math.pi / 4)
        robot = Robot(roll=lean.real, pitch=lean.imag)
        progress = progress_of(robot, turn(arc=sense * 300 * DEGREE), gyro=False)
        assert math.degrees(progress[-1]) == pytest.approx(sense * 300.0, abs=6.0)

    def test_a_known_quarter_turn_of_the_mounting_does_not_matter(self):
        upside_down = Mounting(np.array([1.0, 1.2, 0.9]), rotation_from_rpy(math.pi, 0.0, 1.0))
        robot = replace(ROBOT, mounting=upside_down)
        progress = progress_of(robot, turn(arc=4.0), gyro=False)
        assert progress[-1] == pytest.approx(4.0, abs=0.15)

    def test_the_progress_is_correct_on_a_slope_and_with_wobble(self):
        rng = np.random.default_rng(4)
        wobble = smooth_wobble(rng, 500, 15.0, 4 * DEGREE)
        motion = turn(start_rpy=(0.2, -0.1, 2.0), wobble=wobble, arc=5.0)
        assert progress_of(ROBOT, motion, gyro=False)[-1] == pytest.approx(5.0, abs=0.25)

    def test_a_turn_there_and_back_ends_at_zero(self):
        there = np.linspace(0.0, 4.0, 300)
        angle = np.concatenate([there, there[::-1]])
        motion = turn(arc=1.0, samples=600, duration=20.0)
        motion = replace(motion, attitude=rotation_about(np.array([0.0, 0.0, 1.0]), -angle))
        progress = progress_of(ROBOT, motion, gyro=False)
        assert progress.max() == pytest.approx(4.0, abs=0.15)
        assert progress[-1] == pytest.approx(0.0, abs=0.15)


class TestYawProgressOfAShortTurn:
    @pytest.mark.parametrize("arc", [40.0, -40.0])
    def test_the_gyro_measures_it(self, arc):
        motion = turn(arc=arc * DEGREE, samples=200, duration=4.0)
        progress = progress_of(ROBOT, motion, gyro=True)
        assert math.degrees(progress[-1]) == pytest.approx(arc, abs=2.0)

    def test_the_turn_is_about_up_and_not_about_z_of_the_gyro(self):
        leaning = np.array([math.sin(0.5), 0.0, math.cos(0.5)])
        motion = turn(
            arc=40 * DEGREE, samples=200, duration=4.0, axis=leaning, start_rpy=(0.0, -0.5, 0.0)
        )
        progress = progress_of(ROBOT, motion, gyro=True)
        assert math.degrees(progress[-1]) == pytest.approx(40.0, abs=2.0)

    def test_fewer_than_five_samples_show_nothing(self):
        arc = 40 * DEGREE
        assert progress_of(ROBOT, turn(arc=arc, samples=4, duration=1.0), gyro=True) is None
        assert progress_of(ROBOT, turn(arc=arc, samples=5, duration=1.0), gyro=True) is not None


class TestYawProgressOfARobotThatStands:
    @pytest.mark.parametrize("gyro", [False, True])
    @pytest.mark.parametrize("seconds", [1.0, 10.0, 100.0])
    @pytest.mark.parametrize("seed", range(4))
    def test_noise_shows_no_turn(self, gyro, seconds, seed):
        motion = turn(arc=0.0, samples=int(20 * seconds), duration=seconds)
        assert progress_of(ROBOT, motion, gyro, seed) is None

    @pytest.mark.parametrize("noise", [0.05e-6, 0.5e-6, 2e-6])
    @pytest.mark.parametrize("seed", range(4))
    def test_strong_or_weak_noise_of_the_field_shows_no_turn(self, noise, seed):
        robot = replace(ROBOT, noise_field=noise)
        assert progress_of(robot, turn(arc=0.0), gyro=False, seed=seed) is None

    @pytest.mark.parametrize("bias", [0.016, -0.016])
    @pytest.mark.parametrize("seconds", [5.0, 30.0, 60.0, 90.0, 300.0])
    def test_a_gyro_bias_shows_no_turn(self, bias, seconds):
        robot = replace(ROBOT, gyro_bias=np.array([0.0, 0.0, bias]))
        motion = turn(arc=0.0, samples=1000, duration=seconds)
        assert progress_of(robot, motion, gyro=True) is None

    def test_a_frozen_field_shows_no_turn(self):
        time = np.linspace(0.0, 5.0, 100)
        field = np.tile([20e-6, 0.0, -40e-6], (100, 1))
        force = np.tile([0.0, 0.0, 9.81], (100, 1))
        assert yaw_progress(time, field, force, None) is None

    def test_a_field_that_moves_along_a_line_shows_no_turn(self):
        time = np.linspace(0.0, 5.0, 100)
        field = np.outer(time, [10e-6, 3e-6, 0.0]) + np.array([20e-6, 0.0, -40e-6])
        force = np.tile([0.0, 0.0, 9.81], (100, 1))
        progress = yaw_progress(time, field, force, None)
        assert progress is None or np.ptp(progress) < 0.1


class TestThinToEqualAngles:
    @given(st.lists(st.floats(-20.0, 20.0), min_size=1, max_size=300))
    def test_rows_increase_and_every_measured_heading_is_kept(self, headings):
        progress = np.array(headings)
        kept = thin_to_equal_angles(progress)
        assert (np.diff(kept) > 0).all()

        def bins(values):
            return set((np.mod(values, math.tau) * (180 / math.tau)).astype(int) % 180)

        assert bins(progress[kept]) == bins(progress)

    @given(st.lists(st.floats(-20.0, 20.0), min_size=36, max_size=300), st.integers(180, 300))
    def test_the_limit_is_kept_without_losing_a_heading(self, headings, most):
        progress = np.array(headings)
        kept = thin_to_equal_angles(progress, most)
        assert len(kept) <= most

        def bins(values):
            return set((np.mod(values, math.tau) * (180 / math.tau)).astype(int) % 180)

        assert bins(progress[kept]) == bins(progress)

    def test_an_even_turn_is_not_thinned(self):
        progress = np.linspace(0.0, math.tau, 720, endpoint=False)
        assert len(thin_to_equal_angles(progress)) == 720

    def test_a_pause_has_no_weight(self):
        even = np.linspace(0.0, math.tau, 720, endpoint=False)
        progress = np.concatenate([even[:200], np.full(5000, even[200]), even[200:]])
        kept = thin_to_equal_angles(progress)
        paused = np.abs(progress[kept] - even[200]) < math.radians(1.0)
        assert len(kept) <= 720 + 8
        assert paused.sum() <= 12
        assert set(even.tolist()) - set(progress[kept].tolist()) <= set(even[198:206].tolist())

    def test_the_rows_kept_of_a_pause_are_spread_evenly(self):
        even = np.linspace(0.0, math.tau, 720, endpoint=False)
        progress = np.concatenate([np.full(1000, 0.01), even])
        kept = thin_to_equal_angles(progress)
        assert kept[0] == 0
        in_bin = kept[np.mod(progress[kept], math.tau) < math.radians(2.0)]
        assert np.ptp(in_bin) >= 990

    def test_thinning_twice_changes_nothing(self):
        rng = np.random.default_rng(5)
        progress = np.cumsum(rng.exponential(0.02, 3000))
        once = progress[thin_to_equal_angles(progress)]
        assert len(once) == len(once[thin_to_equal_angles(once)])


@pytest.mark.parametrize(("sense", "side"), [(1.0, "left"), (-1.0, "right")])
def test_the_advice_is_to_go_on_in_the_sense_of_the_turn(sense, side):
    coverage = Coverage.of(sense * np.linspace(0.0, math.radians(250.0), 300))
    assert coverage.advice == f"turn {side}, 110° missing"


def test_a_complete_turn_needs_no_advice():
    assert Coverage.of(np.linspace(0.0, math.radians(355.0), 300)).advice == ""


@pytest.mark.parametrize("dip", [87.0, 88.0, 89.0, 90.0, -89.0])
def test_in_a_steep_field_the_gyro_measures_the_turn(dip):
    robot = Robot(strength=58e-6, inclination=dip * DEGREE)
    window = measure(robot, turn(), np.random.default_rng(1), gyro=True)
    samples = window.time, window.field, window.specific_force
    seen = yaw_progress(*samples, window.angular_rate)
    assert seen[-1] == pytest.approx(2.0 * math.pi, abs=0.1)
    assert Coverage.of(seen).is_complete


def test_a_drifting_gyro_at_rest_shows_no_turn():
    robot = Robot(gyro_bias=np.array([0.0, 0.0, 0.015]))
    window = measure(robot, turn(arc=0.0, duration=90.0), np.random.default_rng(1), gyro=True)
    samples = window.time, window.field, window.specific_force
    assert yaw_progress(*samples, window.angular_rate) is None
