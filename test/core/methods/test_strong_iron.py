"""Soft iron far beyond the prior: a body that weakens the field, and long windows."""

import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from simulated.turns import Motion, measure, turn

from magcal_ros.core import Figure, Reason, Window, calibrate
from magcal_ros.core.assessment.verdict import Grade
from magcal_ros.core.geometry import rotation_about, rotation_from_rpy
from magcal_ros.core.methods.smoother import fit
from magcal_ros.core.simulation import DEGREE, LEVEL_TILT, Robot, heading_errors

pytestmark = pytest.mark.usefixtures("right_axes")


def known(robot):
    return replace(robot.knowledge(1.5e-6, 1.0 * DEGREE), exact_sensors=False)


def level_error(estimate, robot):
    gap = heading_errors(estimate.correction, robot)[:, LEVEL_TILT]
    return math.sqrt(np.mean((gap - gap.mean()) ** 2))


@pytest.mark.parametrize("share", first_of([0.3, 0.5, 0.65]))
@pytest.mark.parametrize("gyro", first_of([True, False]))
def test_a_body_that_weakens_the_level_field_is_fitted_and_reported(share, gyro):
    iron = np.diag([share - 1.05, share - 0.95, -0.2])
    robot = Robot(soft_iron=iron, noise_field=0.2e-6)
    window = measure(robot, turn(arc=7.0), np.random.default_rng(2), gyro=gyro)
    outcome = calibrate(window, known(robot))
    assert outcome.verdict.accepted
    assert outcome.verdict.quality is Grade.WARN
    assert any("reaches the sensor" in check.words for check in outcome.verdict.checks)
    assert outcome.estimate.figures[Figure.LEVEL_SHARE] == pytest.approx(share, abs=0.04)
    assert level_error(outcome.estimate, robot) < 2.0 * DEGREE


@pytest.mark.nightly
def test_a_mirrored_gyro_is_found_in_a_weak_field():
    robot = Robot(soft_iron=np.diag([-0.7, -0.7, 0.0]), noise_field=0.2e-6)
    window = measure(robot, turn(arc=7.0), np.random.default_rng(2), gyro=True)
    mirrored = Window(window.time, window.field, window.specific_force, -window.angular_rate)
    outcome = calibrate(mirrored, known(robot))
    assert not outcome.verdict.accepted
    assert outcome.reason in (Reason.CIRCLE_TOO_SMALL, Reason.AXES_DISAGREE)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", first_of(range(2)))
@pytest.mark.parametrize("wiring", first_of(["ned", "sign", "swap"]))
def test_wrong_axes_are_reported_whatever_the_fit(seed, wiring):
    rng = np.random.default_rng(seed)
    robot = Robot(roll=rng.uniform(-0.3, 0.3), pitch=rng.uniform(-0.3, 0.3))
    window = measure(robot, turn(arc=rng.uniform(1.0, 6.0), samples=200), rng, gyro=True)
    matrix = {"sign": -np.eye(3), "swap": np.eye(3)[[1, 0, 2]], "ned": np.diag([1.0, -1.0, -1.0])}
    rate = window.angular_rate @ matrix[wiring].T
    outcome = calibrate(
        Window(window.time, window.field, window.specific_force, rate), known(robot)
    )
    assert outcome.verdict.summary


def long_drive(seconds, *, weak, seed=0):
    """Two turns at a tilt of 5 degrees, or a yaw of ±90 and a pitch of ±45 degrees; 10 Hz."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 0.1)
    phase = rng.uniform(0.0, math.tau, 3)
    roll = 5.0 * DEGREE * np.sin(math.tau * time / 23.0 + phase[2])
    pitch = (45.0 if weak else 5.0) * DEGREE * np.sin(math.tau * time / 37.0 + phase[1])
    yaw = 2.0 * math.tau * time / seconds
    if weak:
        yaw = 90.0 * DEGREE * np.sin(math.tau * time / 60.0 + phase[0])
    poses = zip(roll, pitch, yaw, strict=True)
    attitude = np.array([rotation_from_rpy(*pose).T for pose in poses])
    iron = np.array([[0.05, 0.09, 0.04], [0.09, -0.16, 0.02], [0.04, 0.02, 0.16]])
    robot = Robot(
        strength=48e-6, soft_iron=iron, roll=0.0, pitch=0.0, noise_field=1e-6, noise_rate=0.01,
        noise_force=0.05, gyro_bias=rng.normal(0.0, 0.003, 3),
    )  # fmt: skip
    return robot, measure(robot, Motion(time, attitude), rng, gyro=True)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("seconds", "weak"),
    [(120.0, False), (600.0, False), (600.0, True)],
)
def test_a_long_window_with_strong_iron_is_better_than_a_short_one(seconds, weak):
    robot, window = long_drive(seconds, weak=weak)
    assert level_error(fit(window, known(robot)), robot) < 0.4 * DEGREE


@pytest.mark.nightly
def test_a_turn_there_and_back_is_not_taken_for_an_acceleration():
    """Its mean rate is zero, and an axis it has all the same."""
    angle = np.concatenate([np.linspace(0.0, 6.5, 300), np.linspace(6.5, 0.0, 300)[1:]])
    time = np.linspace(0.0, 40.0, len(angle))
    up = np.array([0.0, 0.0, 1.0])
    robot = Robot(gyro_bias=np.array([1e-3, -2e-3, 1e-3]))
    motion = Motion(time, rotation_about(up, -angle))
    window = measure(robot, motion, np.random.default_rng(4), gyro=True)
    outcome = calibrate(window, known(robot))
    checks = {check.figure: check for check in outcome.verdict.checks}
    assert checks[Figure.SIDEWAYS_ACCELERATION].grade.rank <= Grade.GOOD.rank
    assert outcome.verdict.accepted
