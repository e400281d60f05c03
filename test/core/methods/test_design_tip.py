"""The design tip: exact where the tip is exact, right or refused where the printed tip is wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import printed_tip
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tip_bridge import knowledge_of, ours, window_of, worst_difference

from magcal_ros.core.conics import ConicFit
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import Knowledge, Mounting
from magcal_ros.core.methods.design_tip import Options, fit
from magcal_ros.core.methods.design_tip.door import passive_rotation
from magcal_ros.core.methods.design_tip.installation import roll_pitch_between
from magcal_ros.core.planes import PlaneFit
from magcal_ros.core.rotations import rotation_from_rpy
from magcal_ros.core.simulator import (
    DEGREE,
    LEVEL_TILT,
    Robot,
    heading_errors,
    measure,
    turn,
)

NORTH = math.pi / 2.0
QUIET = Robot(noise_field=0.0, noise_force=0.0)
VERTICAL = {"axis": (0, 0, 1), "gains": (1, 1, 1), "hard_iron": (0.6, -0.4, 0.5)}
DIP_60 = (0.5, 0.0, math.sqrt(0.75))


def level_turn(robot=QUIET, seed=0, **motion):
    rng = np.random.default_rng(seed)
    motion.setdefault("start_rpy", (0.0, 0.0, rng.uniform(0.0, 2.0 * math.pi)))
    return measure(robot, turn(**motion), rng)


def ramp_turn(robot=QUIET, seed=0, ramp=10.0 * DEGREE, **motion):
    rng = np.random.default_rng(seed)
    azimuth, yaw = rng.uniform(0.0, 2.0 * math.pi, 2)
    start = (ramp * math.cos(azimuth), ramp * math.sin(azimuth), yaw)
    return measure(robot, turn(start_rpy=start, **motion), rng)


def rms_deg(errors):
    return float(np.degrees(np.sqrt(np.mean(np.square(errors)))))


def distance(estimate, robot):
    """Largest relative difference from the true twelve numbers."""
    scale = np.r_[np.ones(9), np.full(3, robot.strength)]
    difference = estimate.correction.parameters - robot.true_correction.parameters
    return np.abs(difference / scale).max()


class TestItsOwnExample:
    @pytest.mark.parametrize("plane", PlaneFit)
    @pytest.mark.parametrize("conic", ConicFit)
    def test_recovers_every_parameter(self, plane, conic):
        example = printed_tip.simulate()
        assert worst_difference(example, ours(example, plane=plane, conic=conic)) < 1e-10

    @pytest.mark.parametrize("plane", printed_tip.NORMALS)
    @pytest.mark.parametrize("conic", printed_tip.CENTRES)
    def test_agrees_with_the_printed_tip(self, plane, conic):
        example = printed_tip.simulate()
        printed = printed_tip.run(example, printed_tip.NORMALS[plane], printed_tip.CENTRES[conic])
        answer = ours(example, plane=plane, conic=conic)
        np.testing.assert_allclose(answer.rotation, printed.rotation, atol=1e-10)
        np.testing.assert_allclose(answer.hard_iron, printed.hard_iron, atol=1e-10)
        np.testing.assert_allclose(answer.axis, printed.axis, atol=1e-10)

    def test_is_the_simulators_turn_as_well(self):
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
        np.testing.assert_allclose(passive_rotation(0.3, 0.2), expected, atol=1e-15)

    def test_the_axis_points_up(self):
        robot = QUIET
        estimate = fit(level_turn(robot), robot.knowledge())
        np.testing.assert_allclose(estimate.axis, [0.0, 0.0, 1.0], atol=1e-9)

    @pytest.mark.parametrize("seed", range(10))
    def test_closed_form_finds_what_made_the_normal(self, seed):
        rng = np.random.default_rng(seed)
        axis = rng.standard_normal(3)
        axis /= np.linalg.norm(axis)
        roll, pitch = rng.uniform(-1.5, 1.5, 2)
        found = roll_pitch_between(axis, passive_rotation(roll, pitch) @ axis)
        assert min(math.hypot(r - roll, p - pitch) for r, p in found) < 1e-7

    def test_closed_form_admits_that_there_is_none(self):
        assert roll_pitch_between(np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])) == []


class TestD3NormalsKeepTheirSense:
    INSTALLATION = (50.0, 0.0)

    def test_the_printed_tip_turns_the_board_over(self):
        example = printed_tip.simulate(installation_deg=self.INSTALLATION)
        assert printed_tip.heading_error_deg(example, printed_tip.run(example)) > 45.0

    def test_ours_does_not(self):
        example = printed_tip.simulate(installation_deg=self.INSTALLATION)
        assert worst_difference(example, ours(example)) < 1e-10

    def test_on_a_grid_of_installations(self):
        wrong = {"printed": 0, "ours": 0}
        for roll in range(-80, 81, 40):
            for pitch in range(-80, 81, 40):
                example = printed_tip.simulate(installation_deg=(roll, pitch))
                wrong["printed"] += worst_difference(example, printed_tip.run(example)) > 1e-6
                wrong["ours"] += worst_difference(example, ours(example, jackknife_blocks=3)) > 1e-9
        assert wrong["printed"] >= 6
        assert wrong["ours"] == 0

    def test_a_gyro_shows_a_board_mounted_upside_down(self):
        robot = replace(QUIET, roll=175.0 * DEGREE)
        rng = np.random.default_rng(0)
        window = measure(robot, turn(), rng, gyro=True)
        assert distance(fit(window, robot.knowledge()), robot) < 1e-9
        without = replace(window, angular_rate=None)
        assert distance(fit(without, robot.knowledge()), robot) > 0.1

    def test_gravity_shows_it_on_a_ramp(self):
        robot = replace(QUIET, roll=175.0 * DEGREE)
        assert distance(fit(ramp_turn(robot), robot.knowledge()), robot) < 1e-9

    def test_a_gyro_that_contradicts_gravity_is_refused(self):
        rng = np.random.default_rng(0)
        window = measure(QUIET, turn(start_rpy=(0.2, 0.0, 0.0)), rng, gyro=True)
        mirrored = replace(window, angular_rate=-window.angular_rate)
        assert refusal(mirrored, QUIET.knowledge()).reason is Reason.AXES_DISAGREE


class TestD4ClosedFormForNewton:
    @pytest.mark.filterwarnings("ignore::RuntimeWarning")
    def test_the_printed_search_never_ends(self):
        example = printed_tip.simulate(axis=(1, 0, 0), installation_deg=(0, 0))
        with pytest.raises(printed_tip.EndlessLoop):
            printed_tip.run(example)

    def test_ours_says_why(self):
        example = printed_tip.simulate(axis=(1, 0, 0), installation_deg=(0, 0))
        with pytest.raises(Refusal, match="horizontal") as caught:
            ours(example)
        assert caught.value.reason is Reason.AXIS_HORIZONTAL

    @pytest.mark.parametrize(
        ("axis", "installation"), [((0.9, 0.9, 0.9), (-80, -60)), ((0.3, 0.3, 0.9), (60, -80))]
    )
    def test_wrong_roots(self, axis, installation):
        example = printed_tip.simulate(axis=axis, installation_deg=installation)
        assert printed_tip.heading_error_deg(example, printed_tip.run(example)) > 45.0
        assert worst_difference(example, ours(example)) < 1e-10


class TestD5AnyStart:
    @pytest.mark.parametrize("start", [30.0, 90.0, 200.0])
    def test_start_heading(self, start):
        example = printed_tip.simulate(start_deg=(0.0, 0.0, start))
        assert printed_tip.heading_error_deg(example, printed_tip.run(example)) > 5.0
        assert worst_difference(example, ours(example)) < 1e-10

    @pytest.mark.parametrize("seed", range(5))
    def test_ramp(self, seed):
        assert distance(fit(ramp_turn(seed=seed), QUIET.knowledge()), QUIET) < 1e-10


class TestD6MeanAccelerationCounts:
    @pytest.mark.parametrize(
        ("rolled", "printed_error"), [(1, 1.0), (2, 2.0), (5, 5.5), (10, 11.5)]
    )
    def test_a_rolled_imu_on_level_ground(self, rolled, printed_error):
        vertical = printed_tip.passive(math.radians(rolled), 0.0) @ [0.0, 0.0, 1.0]
        settings = VERTICAL | {"axis": vertical, "start_deg": (rolled, 0, 0)}
        example = printed_tip.simulate(
            **settings, installation_deg=(3, 4), samples=500, arc_deg=359, noise=0.01
        )
        printed = printed_tip.run(example, noise=0.01)
        assert printed_tip.heading_error_deg(example, printed) > printed_error
        assert printed_tip.heading_error_deg(example, ours(example)) < 0.3


class TestD7NoCliff:
    def example(self, ramp, seed, noise=0.01):
        return printed_tip.simulate(
            **VERTICAL,
            installation_deg=(3, 4),
            start_deg=(ramp, 0, 0),
            samples=100,
            arc_deg=357,
            noise=noise,
            seed=seed,
        )

    def errors(self, ramp, solve):
        turns = [self.example(ramp, seed) for seed in range(6)]
        return rms_of([printed_tip.heading_error_deg(t, solve(t)) for t in turns])

    def test_a_small_change_of_ramp_is_a_small_change_of_error(self):
        def printed(example):
            return printed_tip.run(example, printed_tip.normal_eigen, noise=0.01)

        assert self.errors(3.7, printed) > self.errors(3.0, printed) + 1.0
        assert abs(self.errors(3.7, ours) - self.errors(3.0, ours)) < 0.01
        assert self.errors(3.7, ours) < 0.4

    def test_a_noise_free_rolled_board(self):
        vertical = printed_tip.passive(math.radians(5.0), 0.0) @ [0.0, 0.0, 1.0]
        settings = VERTICAL | {"axis": vertical}
        example = printed_tip.simulate(**settings, start_deg=(5, 0, 0), samples=100, arc_deg=357)
        printed = printed_tip.run(example)
        assert printed_tip.heading_error_deg(example, printed) > 45.0
        assert worst_difference(example, ours(example)) < 1e-9

    @pytest.mark.parametrize(
        ("ramp", "source"),
        [(0.0, "mean"), (0.3, "mean"), (1.0, "mean"), (3.0, "plane"), (10.0, "plane")],
    )
    def test_both_sources_are_never_worse_than_one(self, ramp, source):
        robot = Robot()
        errors = {"auto": [], source: []}
        for seed in range(12):
            window = ramp_turn(robot, seed, ramp * DEGREE)
            for axis, found in errors.items():
                options = Options(axis=axis, jackknife_blocks=3)
                correction = fit(window, robot.knowledge(), options=options).correction
                found.append(heading_errors(correction, robot))
        assert rms_deg(errors["auto"]) < 1.05 * rms_deg(errors[source])


class TestD10DegenerateTurns:
    @pytest.mark.parametrize(
        ("settings", "printed_error", "reason"),
        [
            ({"axis": DIP_60, "noise": 0.01}, 10.0, Reason.AXIS_ALONG_FIELD),
            ({"samples": 4, "noise": 0.01}, 10.0, Reason.TOO_FEW_SAMPLES),
        ],
    )
    def test_silent_in_print_and_refused_here(self, settings, printed_error, reason):
        example = printed_tip.simulate(**settings)
        printed = printed_tip.run(example, noise=0.01)
        assert printed_tip.heading_error_deg(example, printed) > printed_error
        assert refusal(window_of(example), knowledge_of(example)).reason is reason

    def test_horizontal_axis(self):
        example = printed_tip.simulate(axis=(0, 1, 0), noise=0.01)
        with pytest.raises(printed_tip.EndlessLoop):
            printed_tip.run(example, noise=0.01)
        found = refusal(window_of(example), knowledge_of(example))
        assert found.reason is Reason.AXIS_HORIZONTAL

    @pytest.mark.filterwarnings("ignore::RuntimeWarning")
    def test_no_motion(self):
        example = printed_tip.simulate(arc_deg=0)
        assert math.isnan(printed_tip.heading_error_deg(example, printed_tip.run(example)))
        assert refusal(window_of(example), knowledge_of(example)).reason is Reason.NO_MOTION

    @pytest.mark.parametrize("samples", [50, 500])
    def test_no_motion_but_noise(self, samples):
        example = printed_tip.simulate(arc_deg=0, noise=0.01, samples=samples)
        assert refusal(window_of(example), knowledge_of(example)).reason is Reason.NO_MOTION


class TestD11EigenvectorsInAnyOrder:
    def test_the_printed_ellipse_fit_trips_over_two_columns(self):
        x = np.linspace(-1.0, 1.0, 50)
        parabola = np.column_stack([x, x * x])
        with pytest.raises(ValueError, match="unpack"):
            printed_tip.centre_robust(parabola)
        with pytest.raises(Refusal):
            ConicFit.HALIR_FLUSSER(parabola)

    def test_the_printed_normal_trusts_the_order(self):
        angle = np.linspace(0.0, 5.0, 50)
        wrong = {"printed": 0, "ours": 0}
        for seed in range(50):
            normal = np.random.default_rng(seed).standard_normal(3)
            normal /= np.linalg.norm(normal)
            in_plane = np.linalg.svd(normal[None])[2][1:]
            cloud = np.column_stack([np.cos(angle), np.sin(angle)]) @ in_plane
            printed = printed_tip.normal_eigen(cloud, np.linalg.eig)
            wrong["printed"] += abs(printed @ normal) < 0.99
            wrong["ours"] += abs(PlaneFit.EIGEN_SIMPLE(cloud).normal @ normal) < 1.0 - 1e-12
        assert wrong["printed"] > 3
        assert wrong["ours"] == 0


class TestNoise:
    def test_level_full_turn_is_at_least_as_good_as_the_tip(self):
        robot = Robot()
        estimates = [fit(level_turn(robot, seed), robot.knowledge()) for seed in range(30)]
        errors = [heading_errors(estimate.correction, robot) for estimate in estimates]
        assert rms_deg(np.array(errors)[:, :, LEVEL_TILT]) < 0.12
        assert rms_deg(errors) < 0.12
        assert np.mean([e.noise_field for e in estimates]) == pytest.approx(0.5e-6, rel=0.05)
        assert np.mean([e.noise_up for e in estimates]) == pytest.approx(0.01, rel=0.05)

    @pytest.mark.parametrize(("arc", "bound"), [(180.0, 0.3), (90.0, 1.0)])
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

    def test_without_any_the_axial_hard_iron_is_zero_and_said_so(self):
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
    def test_gains_and_nominal_pose_are_taken_off(self):
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
        robot = replace(QUIET, inclination=84.0 * DEGREE)
        found = refusal(level_turn(robot), robot.knowledge(math.inf, 0.0))
        assert found.reason is Reason.FIELD_TOO_STEEP

    def test_small_circle(self):
        robot = replace(QUIET, strength=5e-6)
        found = refusal(level_turn(robot), QUIET.knowledge())
        assert found.reason is Reason.CIRCLE_TOO_SMALL

    def test_tumble(self):
        rng = np.random.default_rng(0)
        attitude = np.linalg.qr(rng.standard_normal((200, 3, 3)))[0]
        window = replace(level_turn(samples=200), field=attitude[:, 0] * 50e-6)
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

    @pytest.mark.parametrize("scale", [0.0, 1.0 / 9.80665])
    def test_no_gravity(self, scale):
        window = level_turn()
        window = replace(window, specific_force=window.specific_force * scale)
        assert refusal(window, QUIET.knowledge()).reason is Reason.GRAVITY_ABSENT

    def test_a_turn_about_body_y_shows_no_pitch(self):
        start = (90.0 * DEGREE, 0.0, 0.0)
        window = level_turn(axis=[0.0, 1.0, 0.0], start_rpy=start)
        assert refusal(window, QUIET.knowledge()).reason is Reason.AMBIGUOUS

    def test_the_plane_of_gravity_alone_on_level_ground(self):
        found = refusal(level_turn(), QUIET.knowledge(), axis="plane")
        assert found.reason is Reason.NO_MOTION


def test_figures_of_a_clean_level_turn():
    robot = Robot()
    figures = fit(level_turn(robot), robot.knowledge()).figures
    assert figures["accelerometer_spread_over_noise"] < 1.0 < figures["field_spread_over_noise"]
    assert figures["field_range_z"] < 0.1 * figures["field_range_x"]
    assert figures["radius_ratio"] == pytest.approx(1.0, abs=0.01)
    assert figures["ellipse_ratio"] == pytest.approx(1.0, abs=0.01)
    assert figures["circle_radius"] == pytest.approx(25e-6, rel=0.01)
    assert all(math.isfinite(value) for value in figures.values())


def rms_of(values):
    return float(np.sqrt(np.mean(np.square(values))))


def refusal(window, knowledge, **options):
    with pytest.raises(Refusal) as caught:
        fit(window, knowledge, options=Options(**options))
    return caught.value


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    samples=st.integers(20, 80),
    kinds=st.tuples(*[st.sampled_from(["noise", "turn", "line", "constant", "huge"])] * 2),
    conic=st.sampled_from(ConicFit),
    plane=st.sampled_from(PlaneFit),
)
def test_whatever_comes_in_an_estimate_is_finite_or_refused(seed, samples, kinds, conic, plane):
    rng = np.random.default_rng(seed)
    robot = Robot()
    turned = level_turn(robot, seed, samples=samples, arc=rng.uniform(0.0, 7.0))
    window = replace(
        turned,
        field=garbage(kinds[0], turned.field, rng),
        specific_force=garbage(kinds[1], turned.specific_force, rng),
    )
    options = Options(conic=conic, plane=plane)
    try:
        estimate = fit(window, robot.knowledge(math.inf, 0.01), options=options)
    except Refusal:
        return
    assert np.isfinite(estimate.correction.parameters).all()
    assert np.isfinite(estimate.residual).all()
    assert all(math.isfinite(value) for value in estimate.figures.values())
    assert np.linalg.eigvalsh(estimate.covariance).min() > -1e-9


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
