"""What the robot itself switches on, seen from a rest and from outliers."""

from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from uneven_turns import ROBOT, collected, driven, evenly, stop_and_go

from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.knowledge import Systematics
from magcal_ros.core.methods.maximum_likelihood.fit import solve
from magcal_ros.core.simulation.simulator import Trouble, measure, turn

KNOWN = replace(ROBOT.knowledge(1.5e-6, 0.02), systematics=Systematics())
FIELD = np.array([0.9e-6, -1.2e-6, 1.0e-6])


def with_field(window, states, field=FIELD):
    return replace(window, field=window.field + np.outer(states, field))


@pytest.mark.parametrize("course", first_of([evenly, stop_and_go]))
def test_what_comes_with_the_movement_is_measured_and_said(course):
    motion, window = driven(course)
    spoilt = with_field(window, np.abs(motion.angular_rate[:, 2]) > 0.02)
    outcome = calibrate(collected(spoilt), KNOWN)
    figures = outcome.estimate.figures
    assert figures[Figure.MOTOR_FIELD] == pytest.approx(np.linalg.norm(FIELD), rel=0.2)
    told = [check for check in outcome.verdict.checks if check.figure is Figure.MOTOR_FIELD]
    assert "between rest and turn the field changes" in told[0].words
    assert "it is taken off while the robot moves" in told[0].words
    iron = outcome.estimate.correction.hard_iron - ROBOT.hard_iron
    sigma = np.sqrt(np.diag(outcome.estimate.covariance)[9:])
    assert (np.abs(iron) < 2.0 * sigma).all()


@pytest.mark.parametrize("seed", first_of([1, 2, 3, 4, 5]))
def test_without_a_gyro_a_rest_off_the_turns_path_shows_them(seed):
    motion, window = driven(evenly, seed=seed)
    way = np.random.default_rng(seed).standard_normal(3)
    field = 2e-6 * way / np.linalg.norm(way)
    spoilt = with_field(window, np.abs(motion.angular_rate[:, 2]) > 0.02, field)
    outcome = calibrate(collected(replace(spoilt, angular_rate=None)), KNOWN)
    assert outcome.estimate.figures[Figure.MOTOR_FIELD] == pytest.approx(2e-6, rel=0.5)
    iron = outcome.estimate.correction.hard_iron - ROBOT.hard_iron
    covariance = outcome.estimate.covariance[9:, 9:]
    assert iron @ np.linalg.solve(covariance, iron) < 12.0


@pytest.mark.parametrize("gyro", [True, False])
def test_quiet_motors_add_nothing(gyro):
    window = driven(evenly)[1]
    window = window if gyro else replace(window, angular_rate=None)
    np.testing.assert_array_equal(solve(collected(window), KNOWN).motors, 0.0)


@pytest.mark.parametrize("gyro", [True, False])
def test_what_switches_on_the_way_is_seen_in_the_outliers(gyro):
    window = measure(ROBOT, turn(samples=600, duration=20.0), np.random.default_rng(2), gyro=gyro)
    solved = solve(with_field(window, window.time % 4.0 < 2.5, 2.0 * FIELD), KNOWN)
    size = 2.0 * np.linalg.norm(FIELD)
    assert np.linalg.norm(solved.motors) == pytest.approx(size, rel=0.1 if gyro else 0.4)


@pytest.mark.parametrize(
    "trouble", [Trouble(outliers=0.2), Trouble(disturbance=10e-6), Trouble(vibration=0.3)]
)
def test_what_passes_by_is_no_motor(trouble):
    motion = turn(samples=600, duration=20.0)
    window = measure(ROBOT, motion, np.random.default_rng(3), gyro=True, trouble=trouble)
    assert solve(window, KNOWN).motors is None
