"""The smoother recovers simulated turns within its sigma."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from simulated.turns import measure, turn
from uneven_turns import ROBOT, collected, driven, evenly

from magcal_ros.core import Figure, Grade, Knowledge, Reason, Window, calibrate
from magcal_ros.core.calibration import predicted_heading_sigma
from magcal_ros.core.methods.smoother import fit
from magcal_ros.core.simulation import DEGREE, LEVEL_TILT, Robot, heading_errors
from magcal_ros.core.smoother import AT, UNKNOWNS, Damping, smooth

pytestmark = pytest.mark.usefixtures("right_axes")


def known(robot: Robot):
    """Return what is known of a robot whose sensors have the usual errors."""
    return replace(robot.knowledge(1.5e-6, 1.0 * DEGREE), exact_sensors=False)


def error_of(estimate, robot: Robot) -> float:
    gap = heading_errors(estimate.correction, robot)[:, LEVEL_TILT]
    return math.sqrt(float(np.mean(gap**2)))


def with_motors(window: Window, motion, size: float, *, by_rate: bool) -> Window:
    """Return a window with a field of the motors (tesla), in step with motion or by the rate."""
    rate = motion.angular_rate[:, 2]
    shape = rate / np.abs(rate).max() if by_rate else (np.abs(rate) > 0.02).astype(float)
    return replace(window, field=window.field + size * np.outer(shape, [0.6, -0.8, 0.0]))


def test_a_clean_turn_is_recovered():
    robot = Robot(noise_field=0.3e-6)
    estimate = fit(measure(robot, turn(), np.random.default_rng(1), gyro=True), known(robot))
    assert error_of(estimate, robot) < 0.15 * DEGREE
    assert predicted_heading_sigma(estimate, 0.0) < 0.7 * DEGREE
    assert estimate.arc > 0.95 * math.tau
    assert estimate.message == "converged"
    assert estimate.figures[Figure.GYRO_COMPASS_SWING] < 0.5 * DEGREE


@pytest.mark.nightly
@pytest.mark.parametrize("by_rate", [False, True])
@pytest.mark.parametrize("size", [3e-6, 20e-6])
def test_rests_distinguish_the_motor_field_from_hard_iron(size, by_rate):
    motion, window = driven(evenly, ROBOT, 3.0)
    estimate = fit(collected(with_motors(window, motion, size, by_rate=by_rate)), known(ROBOT))
    error = error_of(estimate, ROBOT)
    assert error < 0.5 * DEGREE
    assert error < 3.0 * predicted_heading_sigma(estimate, 0.0)
    assert estimate.figures[Figure.ON_THE_SPOT] > 0.8
    assert estimate.figures[Figure.MOTOR_FIELD] == pytest.approx(size, rel=0.1)


@pytest.mark.parametrize(
    ("size", "grade"),
    [(2e-6, Grade.WARN), pytest.param(0.0, Grade.EXCELLENT, marks=pytest.mark.nightly)],
)
def test_hard_iron_that_drifts_is_named(size, grade):
    _, window = driven(evenly, ROBOT, 3.0)
    share = window.time / np.ptp(window.time)
    added = size * np.outer(share - share.mean(), [0.6, -0.8, 0.0])
    outcome = calibrate(collected(replace(window, field=window.field + added)), known(ROBOT))
    checks = {check.figure: check for check in outcome.verdict.checks}
    assert checks[Figure.IRON_DRIFT].grade is grade
    assert outcome.estimate.figures[Figure.IRON_DRIFT] == pytest.approx(size, rel=0.25)


@pytest.mark.nightly
def test_a_smooth_circle_has_a_large_and_correct_sigma():
    """A bias of the gyro across up looks the same where nothing rests."""
    robot = replace(ROBOT, inclination=68.0 * DEGREE)
    motion, window = driven(lambda time: 1.0 + 0.0 * time, robot, 0.0)
    rate = motion.angular_rate[:, 2]
    across, up = np.array([0.8, 0.6, 0.0]), motion.attitude[:, :, 2]
    # The acceleration stays level while the body sways. The circle has a radius of 3 m.
    level = across - (up @ across)[:, None] * up
    force = window.specific_force + (3.0 * rate**2)[:, None] * level
    found = smooth(replace(window, specific_force=force), known(robot))
    gap = heading_errors(found.posterior.correction, robot)[:, LEVEL_TILT]
    assert found.weights["small circle"] > 0.1
    assert found.posterior.heading_sigma > 1.0 * DEGREE
    assert math.sqrt(float(np.mean(gap**2))) < 3.0 * found.posterior.heading_sigma


@pytest.mark.nightly
def test_a_disturbed_field_shows_in_the_deviation_of_compass_from_gyro():
    motion, window = driven(evenly, ROBOT, 3.0)
    yaw = np.arctan2(motion.attitude[:, 0, 1], motion.attitude[:, 0, 0])
    bent = 3e-6 * np.column_stack([np.cos(yaw), np.sin(2.0 * yaw), np.zeros(len(yaw))])
    field = window.field + np.einsum("nij,nj->ni", motion.attitude, bent)
    estimate = fit(collected(replace(window, field=field)), known(ROBOT))
    assert estimate.figures[Figure.GYRO_COMPASS_SWING] > 1.0 * DEGREE


@pytest.mark.nightly
def test_soft_iron_is_found():
    iron = np.diag([0.04, -0.04, 0.0])
    robot = Robot(soft_iron=iron, noise_field=0.3e-6)
    # Without a rest, the robot might as well drive a circle.
    _, window = driven(evenly, robot, 0.0)
    estimate = fit(collected(window), known(robot))
    error = error_of(estimate, robot)
    assert error < 0.35 * DEGREE
    assert error < 3.0 * predicted_heading_sigma(estimate, 0.0)


def test_absent_effects_are_near_zero():
    robot = Robot(noise_field=0.3e-6)
    window = measure(robot, turn(), np.random.default_rng(2), gyro=True)
    shared = smooth(window, known(robot)).fit.state.shared
    for name in ("axes", "motors_moving", "motors_rate", "drift", "latency"):
        usual = np.array(UNKNOWNS[name].sigma)
        assert (np.abs(shared[AT[name]]) < 1.5 * usual).all(), name


@pytest.mark.nightly
def test_squared_errors_match_their_variance():
    ratios = []
    for seed in range(24):
        rng = np.random.default_rng([11, seed])
        robot = Robot(
            noise_field=0.3e-6,
            hard_iron=rng.normal(0.0, 20e-6, 3),
            gyro_bias=rng.normal(0.0, 0.002, 3),
            soft_iron=np.diag(rng.normal(0.0, 0.005, 3)),
        )
        estimate = fit(measure(robot, turn(), rng, gyro=True), known(robot))
        ratios.append((error_of(estimate, robot) / predicted_heading_sigma(estimate, 0.0)) ** 2)
    assert np.mean(ratios) < 1.5


def slowly(every: int, seed: int, *, means: bool) -> Window:
    """A turn of a minute that sways by a degree, of which a driver publishes every so many samples.

    Or their means. 30 samples come in a second.
    """
    _, window = driven(evenly, ROBOT, 8.0, seed=seed)
    count = len(window.time) // every * every

    def thinned(values):
        cut = values[:count].reshape(-1, every, *values.shape[1:])
        return cut.mean(axis=1) if means else cut[:, 0]

    each = (window.time, window.field, window.specific_force, window.angular_rate)
    return collected(Window(*(thinned(values) for values in each)))


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("every", "means"),
    [
        (30, True),
        pytest.param(6, False, marks=pytest.mark.nightly),
        *(pytest.param(every, True, marks=pytest.mark.nightly) for every in (6, 15)),
    ],
    ids=str,
)
def test_slow_samples_determine_the_turn_but_not_its_sway(every, means, monkeypatch):
    """The sway alone determines the vertical hard iron; slow gyro samples miss most of it."""
    monkeypatch.setattr("uneven_turns.SECONDS", 60.0)
    estimate = fit(slowly(every, 2, means=means))
    rms = np.sqrt(np.mean(heading_errors(estimate.correction, ROBOT) ** 2, axis=0))
    assert rms[LEVEL_TILT] < 0.3 * DEGREE
    assert rms.max() < 2.5 * predicted_heading_sigma(estimate, 10.0 * DEGREE)


@pytest.mark.nightly
@pytest.mark.parametrize("means", [False, True])
@pytest.mark.parametrize("every", [5, 6])
def test_tilted_headings_at_5_hz_have_a_correct_sigma(every, means, monkeypatch):
    """Single readings erred 1.5 times the sigma: half of the sway of 2 Hz was missed."""
    monkeypatch.setattr("uneven_turns.SECONDS", 60.0)
    ratios = []
    for seed in range(1, 11):
        estimate = fit(slowly(every, seed, means=means))
        rms = np.sqrt(np.mean(heading_errors(estimate.correction, ROBOT) ** 2, axis=0))
        ratios.append(rms.max() / predicted_heading_sigma(estimate, 10.0 * DEGREE))
    assert np.mean(np.square(ratios)) < 1.5


@pytest.mark.parametrize("every", first_of([30, 15]))
def test_a_swaying_turn_sampled_once_a_second_is_refused(every, monkeypatch):
    """Explained by a drive they erred by 20 degrees at 10 degrees of tilt, sigma 2.4."""
    monkeypatch.setattr("uneven_turns.SECONDS", 60.0)
    outcome = calibrate(slowly(every, 2, means=False), Knowledge())
    assert outcome.reason is Reason.TOO_SLOW
    assert f"come at {30 // every} Hz" in outcome.verdict.summary


def test_a_fit_reports_its_progress():
    window = measure(ROBOT, turn(duration=20.0), np.random.default_rng(3), gyro=True)
    reported: list[float] = []
    assert calibrate(window, known(ROBOT), progress=reported.append).verdict.accepted
    assert reported == sorted(reported)
    assert 0.0 <= reported[0] < 0.1 < 0.25 < reported[-1] <= 1.0


def test_steps_are_shortened_after_a_loss_of_evidence():
    worse = Damping().next(10.0).next(12.0)
    assert worse.share == 0.5
    assert worse.next(13.0).share == 0.25
    assert worse.next(11.0).share == 0.75
    assert Damping().next(10.0).next(9.0).share == 1.0
