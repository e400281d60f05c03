"""The design tip: exact where the tip is exact, right or refused where the printed tip is wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import printed_tip
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from simulated.turns import measure, turn
from tip_bridge import ours, window_of, worst_difference
from tip_turns import QUIET, distance, level_turn, ramp_turn, refusal, rms_deg
from tumbles import hand_tumbling, tumble

from magcal_ros.core import Knowledge, Mounting, Reason, Refusal
from magcal_ros.core.geometry import roll_pitch_between, rotation_from_rpy
from magcal_ros.core.methods.design_tip import fit
from magcal_ros.core.simulation import DEGREE, LEVEL_TILT, Robot, heading_errors

NORTH = math.pi / 2.0


class TestItsOwnExample:
    def test_the_example_gives_every_parameter(self):
        example = printed_tip.simulate()
        assert worst_difference(example, ours(example)) < 1e-10

    @pytest.mark.parametrize("plane", printed_tip.NORMALS)
    @pytest.mark.parametrize("conic", printed_tip.CENTRES)
    def test_agrees_with_the_printed_tip(self, plane, conic):
        example = printed_tip.simulate()
        printed = printed_tip.run(example, printed_tip.NORMALS[plane], printed_tip.CENTRES[conic])
        answer = ours(example)
        np.testing.assert_allclose(answer.rotation, printed.rotation, atol=1e-10)
        np.testing.assert_allclose(answer.hard_iron, printed.hard_iron, atol=1e-10)
        np.testing.assert_allclose(answer.axis, printed.axis, atol=1e-10)

    def test_the_example_agrees_with_the_simulator(self):
        example = window_of(printed_tip.simulate())
        robot = replace(
            QUIET,
            strength=1.0,
            roll=20.0 * DEGREE,
            pitch=-30.0 * DEGREE,
            hard_iron=[0.1, 0.2, -0.3],
            mounting=Mounting(gains=[0.5, 1.2, 0.9]),
        )
        motion = turn(
            arc=315 * DEGREE, axis=[0, -0.9, -0.9], start_rpy=(0.0, 0.0, NORTH), samples=50
        )
        same = measure(robot, motion, np.random.default_rng(0))
        np.testing.assert_allclose(same.field, example.field, atol=1e-12)
        np.testing.assert_allclose(same.specific_force, example.specific_force, atol=1e-11)

    @pytest.mark.nightly
    def test_with_its_noise_stays_near_the_printed_figures(self):
        errors = []
        for seed in range(40):
            example = printed_tip.simulate(noise=0.01, seed=seed)
            errors.append(printed_tip.heading_error_deg(example, ours(example)))
        assert np.sqrt(np.mean(np.square(errors))) < 0.57


class TestConventions:
    def test_its_rotation_is_the_urdf_pose_with_the_pitch_negated(self):
        flip = np.diag([1.0, -1.0, -1.0])
        expected = flip @ rotation_from_rpy(0.3, -0.2).T @ flip
        np.testing.assert_allclose(rotation_from_rpy(0.3, 0.2).T, expected, atol=1e-15)

    def test_the_axis_points_up(self):
        robot = QUIET
        estimate = fit(level_turn(robot), robot.knowledge())
        np.testing.assert_allclose(estimate.axis, [0.0, 0.0, 1.0], atol=1e-9)

    @pytest.mark.parametrize("seed", range(10))
    def test_the_closed_form_inverts_the_normal(self, seed):
        rng = np.random.default_rng(seed)
        axis = rng.standard_normal(3)
        axis /= np.linalg.norm(axis)
        roll, pitch = rng.uniform(-1.5, 1.5, 2)
        found = roll_pitch_between(axis, rotation_from_rpy(roll, pitch).T @ axis)
        assert min(math.hypot(r - roll, p - pitch) for r, p in found) < 1e-7

    def test_the_closed_form_reports_that_there_is_no_solution(self):
        assert roll_pitch_between(np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])) == []


class TestNoise:
    def test_level_full_turn_is_at_least_as_good_as_the_tip(self):
        robot = Robot()
        estimates = [fit(level_turn(robot, seed), robot.knowledge()) for seed in range(15)]
        errors = [heading_errors(estimate.correction, robot) for estimate in estimates]
        assert rms_deg(np.array(errors)[:, :, LEVEL_TILT]) < 0.12
        assert rms_deg(errors) < 0.12
        assert np.mean([e.noise_field for e in estimates]) == pytest.approx(0.5e-6, rel=0.05)
        assert np.mean([e.noise_up for e in estimates]) == pytest.approx(0.01, rel=0.05)

    @pytest.mark.nightly
    @pytest.mark.parametrize(
        ("arc", "bound"), [(90.0, 1.0), pytest.param(180.0, 0.3, marks=pytest.mark.nightly)]
    )
    def test_parts_of_a_turn(self, arc, bound):
        robot = Robot()
        windows = [level_turn(robot, seed, arc=arc * DEGREE) for seed in range(20)]
        found = [fit(window, robot.knowledge()) for window in windows]
        assert rms_deg([heading_errors(e.correction, robot) for e in found]) < bound
        assert np.mean([e.arc for e in found]) == pytest.approx(arc * DEGREE, rel=0.05)


class TestReference:
    @pytest.mark.parametrize("window", [level_turn(), ramp_turn()], ids=["level", "ramp"])
    @pytest.mark.parametrize(("strength", "inclination"), [(0.0, math.inf), (math.inf, 0.0)])
    def test_one_number_is_enough(self, window, strength, inclination):
        estimate = fit(window, QUIET.knowledge(strength, inclination))
        assert distance(estimate, QUIET) < 1e-9
        assert estimate.strength == pytest.approx(QUIET.strength, rel=1e-9)
        assert estimate.inclination == pytest.approx(QUIET.inclination, rel=1e-9)

    @pytest.mark.parametrize("inclination", [-60.0, 0.0, 45.0, 70.0])
    def test_inclination_alone_anywhere(self, inclination):
        robot = replace(QUIET, inclination=inclination * DEGREE)
        estimate = fit(ramp_turn(robot), robot.knowledge(math.inf, 0.0))
        assert distance(estimate, robot) < 1e-9

    def test_without_a_reference_the_axial_hard_iron_is_zero_and_reported(self):
        estimate = fit(level_turn(), Knowledge())
        assert estimate.figures["axial_hard_iron"] == pytest.approx(0.0, abs=1e-12)
        assert "no hard iron along the axis is assumed" in estimate.message
        along = estimate.correction.matrix[2]
        sigma = math.sqrt(along @ estimate.covariance[9:, 9:] @ along)
        assert sigma == pytest.approx(50e-6, rel=0.01)

    def test_its_uncertainty_enters_the_covariance(self):
        exact = fit(level_turn(), QUIET.knowledge())
        loose = fit(level_turn(), QUIET.knowledge(1e-6, 0.0))
        along = exact.correction.matrix[2]
        extra = along @ (loose.covariance - exact.covariance)[9:, 9:] @ along
        assert math.sqrt(extra) == pytest.approx(1e-6 * math.sin(QUIET.inclination), rel=1e-3)

    def test_a_circle_larger_than_the_field_is_refused(self):
        robot = replace(QUIET, strength=10e-6)
        found = refusal(level_turn(), robot.knowledge(0.0, math.inf))
        assert found.reason is Reason.NO_SOLUTION


class TestMounting:
    def test_gains_and_nominal_pose_are_removed(self):
        mounting = Mounting(gains=[0.8, 1.2, 0.9], pose=rotation_from_rpy(0.4, -0.5, 2.0))
        robot = replace(QUIET, mounting=mounting)
        assert distance(fit(ramp_turn(robot), robot.knowledge()), robot) < 1e-10
        noisy = replace(robot, noise_field=0.5e-6, noise_force=0.1)
        estimate = fit(level_turn(noisy), noisy.knowledge())
        assert estimate.noise_field == pytest.approx(0.5e-6, rel=0.1)


class TestRefusals:
    def test_short_arc(self):
        found = refusal(level_turn(arc=40.0 * DEGREE), QUIET.knowledge())
        assert found.reason is Reason.ARC_TOO_SHORT
        assert "40°" in str(found)

    def test_steep_field(self):
        robot = replace(QUIET, inclination=86.0 * DEGREE)
        found = refusal(level_turn(robot), robot.knowledge(math.inf, 0.0))
        assert found.reason is Reason.FIELD_TOO_STEEP

    def test_small_circle(self):
        robot = replace(QUIET, strength=5e-6)
        found = refusal(level_turn(robot), QUIET.knowledge())
        assert found.reason is Reason.CIRCLE_TOO_SMALL

    def test_tumble(self):
        window = replace(level_turn(), field=tumble(motion=hand_tumbling).field[:500])
        assert refusal(window, QUIET.knowledge()).reason is Reason.FIELD_NOT_ON_A_PLANE

    def test_straight_swing_of_the_field(self):
        window = level_turn(Robot(), samples=50)
        rng = np.random.default_rng(0)
        line = np.outer(np.linspace(0.0, 1.0, 50), [20e-6, 10e-6, 5e-6])
        window = replace(window, field=line + 0.5e-6 * rng.standard_normal((50, 3)))
        assert refusal(window, QUIET.knowledge()).reason is Reason.FIELD_ON_A_LINE

    def test_no_field(self):
        window = replace(level_turn(), field=np.zeros((500, 3)))
        assert refusal(window, QUIET.knowledge()).reason is Reason.FIELD_ABSENT

    @pytest.mark.parametrize("scale", [0.0, 0.7 / 9.80665])
    def test_no_gravity(self, scale):
        window = level_turn()
        window = replace(window, specific_force=window.specific_force * scale)
        assert refusal(window, QUIET.knowledge()).reason is Reason.GRAVITY_ABSENT

    def test_a_turn_about_body_y_shows_no_pitch(self):
        start = (90.0 * DEGREE, 0.0, 0.0)
        window = level_turn(axis=[0.0, 1.0, 0.0], start_rpy=start)
        assert refusal(window, QUIET.knowledge()).reason is Reason.AMBIGUOUS


def test_figures_of_a_clean_level_turn():
    robot = Robot()
    figures = fit(level_turn(robot), robot.knowledge()).figures
    assert figures["accelerometer_spread_over_noise"] < 1.0 < figures["field_spread_over_noise"]
    assert figures["field_range_z"] < 0.1 * figures["field_range_x"]
    assert figures["radius_ratio"] == pytest.approx(1.0, abs=0.01)
    assert figures["ellipse_ratio"] == pytest.approx(1.0, abs=0.01)
    assert figures["circle_radius"] == pytest.approx(25e-6, rel=0.01)
    assert all(math.isfinite(value) for value in figures.values())


@examples(60)
@given(
    seed=st.integers(0, 10_000),
    samples=st.integers(20, 80),
    kinds=st.tuples(*[st.sampled_from(["noise", "turn", "line", "constant", "huge"])] * 2),
)
def test_any_input_gives_a_finite_estimate_or_a_refusal(seed, samples, kinds):
    rng = np.random.default_rng(seed)
    robot = Robot()
    turned = level_turn(robot, seed, samples=samples, arc=rng.uniform(0.0, 7.0))
    window = replace(
        turned,
        field=garbage(kinds[0], turned.field, rng),
        specific_force=garbage(kinds[1], turned.specific_force, rng),
    )
    try:
        estimate = fit(window, robot.knowledge(math.inf, 0.01))
    except Refusal:
        return
    assert np.isfinite(estimate.correction.parameters).all()
    assert np.isfinite(estimate.residual).all()
    assert all(math.isfinite(value) for value in estimate.figures.values())
    variances = np.linalg.eigvalsh(estimate.covariance)
    assert variances.min() > -1e-12 * variances.max()


def garbage(kind, honest, rng):
    direction = rng.standard_normal(3)
    scale = np.abs(honest).max()
    return {
        "noise": scale * rng.standard_normal(honest.shape),
        "turn": honest,
        "line": scale * np.outer(rng.uniform(-1.0, 1.0, len(honest)), direction),
        "constant": scale * np.tile(direction, (len(honest), 1)),
        "huge": 1e9 * honest,
    }[kind]
