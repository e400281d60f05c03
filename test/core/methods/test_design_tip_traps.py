"""The errors of the printed tip, by number: it makes each of them, this package none."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import printed_tip
import pytest
from long_form import first_of
from simulated.turns import measure, turn
from tip_bridge import knowledge_of, ours, window_of, worst_difference
from tip_turns import QUIET, distance, ramp_turn, refusal, rms_deg, rms_of

from magcal_ros.core import Reason, Refusal
from magcal_ros.core.geometry import ellipse_ratio, fit_plane
from magcal_ros.core.methods.design_tip import fit
from magcal_ros.core.simulation import DEGREE, Robot, heading_errors

VERTICAL = {"axis": (0, 0, 1), "gains": (1, 1, 1), "hard_iron": (0.6, -0.4, 0.5)}
DIP_60 = (0.5, 0.0, math.sqrt(0.75))


class TestD3NormalsKeepTheirSense:
    INSTALLATION = (50.0, 0.0)

    def test_the_printed_tip_turns_the_board_over(self):
        example = printed_tip.simulate(installation_deg=self.INSTALLATION)
        assert printed_tip.heading_error_deg(example, printed_tip.run(example)) > 45.0

    def test_this_package_does_not(self):
        example = printed_tip.simulate(installation_deg=self.INSTALLATION)
        assert worst_difference(example, ours(example)) < 1e-10

    @pytest.mark.nightly
    def test_on_a_grid_of_installations(self):
        wrong = {"printed": 0, "ours": 0}
        for roll in range(-80, 81, 40):
            for pitch in range(-80, 81, 40):
                example = printed_tip.simulate(installation_deg=(roll, pitch))
                wrong["printed"] += worst_difference(example, printed_tip.run(example)) > 1e-6
                wrong["ours"] += worst_difference(example, ours(example)) > 1e-9
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

    def test_this_package_gives_the_reason(self):
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

    @pytest.mark.parametrize("seed", first_of(range(5)))
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

    @pytest.mark.nightly
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

    @pytest.mark.parametrize("ramp", first_of([0.3, 10.0, 0.0, 1.0, 3.0], 2))
    def test_the_heading_is_as_good_on_every_ramp(self, ramp):
        robot = Robot()
        errors = []
        for seed in range(12):
            correction = fit(ramp_turn(robot, seed, ramp * DEGREE), robot.knowledge()).correction
            errors.append(heading_errors(correction, robot))
        assert rms_deg(errors) < 0.13


class TestD10DegenerateTurns:
    @pytest.mark.parametrize(
        ("settings", "printed_error", "reason"),
        [
            ({"axis": DIP_60, "noise": 0.01}, 10.0, Reason.AXIS_ALONG_FIELD),
            ({"samples": 4, "noise": 0.01}, 5.0, Reason.TOO_FEW_SAMPLES),
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
        assert ellipse_ratio(parabola) is None or ellipse_ratio(parabola) > 10.0

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
            wrong["ours"] += abs(fit_plane(cloud).normal @ normal) < 1.0 - 1e-12
        assert wrong["printed"] > 3
        assert wrong["ours"] == 0
