"""The smoother recovers turns without a gyro, or with a dead axis of the gyro."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from realistic_robots import by_rested_turn, by_turn, collected
from realistic_robots import heading_error as turn_error
from simulated.turns import Motion, measure, smooth_wobble, turn

from magcal_ros.core import Figure, Knowledge, Reason, Refusal, Window
from magcal_ros.core.calibration import predicted_heading_sigma
from magcal_ros.core.methods.smoother import fit
from magcal_ros.core.samples import working_axes
from magcal_ros.core.simulation import DEGREE, LEVEL_TILT, Robot, heading_errors
from magcal_ros.core.smoother import nodes_of

ROBOT = Robot(noise_field=0.3e-6, noise_force=0.05)


def known(robot: Robot) -> Knowledge:
    return replace(robot.knowledge(1.5e-6, 1.0 * DEGREE), exact_sensors=False)


def error_of(estimate, robot: Robot) -> float:
    return math.sqrt(float(np.mean(heading_errors(estimate.correction, robot)[:, LEVEL_TILT] ** 2)))


def error_on_slopes(estimate, robot: Robot) -> float:
    errors = heading_errors(estimate.correction, robot)
    return math.sqrt(float(np.mean(np.delete(errors, LEVEL_TILT, axis=1) ** 2)))


def down_of(estimate) -> float:
    """Return the downward field over the true one."""
    down = estimate.strength * math.sin(estimate.inclination)
    return float(down / (ROBOT.strength * math.sin(ROBOT.inclination)))


@pytest.fixture(scope="module")
def level():
    """Return a level turn and its fit."""
    window = measure(ROBOT, turn(), np.random.default_rng(2))
    return window, fit(window, known(ROBOT))


@pytest.mark.parametrize("sense", first_of([-1.0, 1.0]))
@pytest.mark.parametrize(
    ("axis", "start"),
    [pytest.param((0.0, 0.9, 0.9), (0.0, 0.0, 0.3), id="tilted axis"),
     *(pytest.param((0.0, 0.0, 1.0), start, id=name, marks=pytest.mark.nightly)
       for name, start in (("level", (0.0, 0.0, 0.3)), ("slope", (0.2, 0.0, 0.3))))],
)  # fmt: skip
def test_a_turn_is_recovered_about_any_axis_in_either_sense(axis, start, sense):
    motion = turn(arc=sense * math.tau, axis=np.array(axis), start_rpy=start)
    window = measure(ROBOT, motion, np.random.default_rng(1))
    estimate = fit(window, known(ROBOT))
    error = error_of(estimate, ROBOT)
    assert error < 0.5 * DEGREE
    assert error < 3.0 * predicted_heading_sigma(estimate, 0.0)
    assert predicted_heading_sigma(estimate, 0.0) < 1.8 * DEGREE
    assert estimate.arc > 0.95 * math.tau
    assert estimate.swing is None
    assert Figure.GYRO_CARRIED not in estimate.figures


@pytest.mark.nightly
def test_a_board_that_is_mounted_upside_down_is_recovered(level):
    flip = np.diag([1.0, -1.0, -1.0])
    window, upright = level
    turned = Window(window.time, window.field @ flip, window.specific_force @ flip)
    estimate = fit(turned, known(ROBOT))
    np.testing.assert_allclose(
        flip @ estimate.correction.matrix @ flip, upright.correction.matrix, atol=0.03
    )
    np.testing.assert_allclose(
        estimate.correction.hard_iron @ flip, upright.correction.hard_iron, atol=0.5e-6
    )


def swaying(height: float, seed: int) -> Window:
    """Return a turn whose sway moves an accelerometer that is so many metres above the pivot."""
    rng = np.random.default_rng(seed)
    sway = smooth_wobble(rng, 600, 20.0, 2.0 * DEGREE, (0.2, 1.0))
    motion = turn(samples=600, duration=20.0, wobble=sway)
    window = measure(ROBOT, motion, rng)
    moved = np.gradient(height * motion.attitude[:, 2], motion.time, axis=0)
    shaken = np.gradient(moved, motion.time, axis=0)
    acceleration = np.einsum("nij,nj->ni", motion.attitude, shaken)
    return replace(window, specific_force=window.specific_force + acceleration)


@pytest.mark.nightly
@pytest.mark.parametrize("height", first_of([0.3, 0.0]))
def test_tilt_is_distinguished_from_sway_of_a_high_accelerometer(height):
    """Taken for lean, the shaking would shrink the field: the heading on slopes would be wrong."""
    estimate = fit(swaying(height, 3), Knowledge())
    error = error_on_slopes(estimate, ROBOT)
    assert error < 3.0 * predicted_heading_sigma(estimate, 10.0 * DEGREE)
    assert error < 3.0 * DEGREE
    assert abs(down_of(estimate) - 1.0) < 0.05


@pytest.mark.nightly
@pytest.mark.parametrize("number", first_of([9910, 9909, 9904]))
def test_sway_beside_the_pivot_is_not_taken_for_a_long_lever_arm(number):
    """A lever arm would explain the changes upward by a lean of the body, and hide the true one."""
    scene, knowledge = by_turn("fast", "typical", "open")(number)
    estimate = fit(replace(scene.window, angular_rate=None), knowledge)
    error = turn_error(scene, estimate.correction)
    assert error < 3.0 * predicted_heading_sigma(estimate, 0.0)
    assert error < 1.0 * DEGREE


@pytest.mark.nightly
@pytest.mark.parametrize("height", [0.3, 0.0])
def test_the_size_of_the_sway_is_unbiased(height):
    """The most likely leans are too small, and with them the downward field is too large."""
    ratios = []
    for seed in range(5, 9):
        estimate = fit(swaying(height, seed), Knowledge())
        ratios.append(down_of(estimate) - 1.0)
        error = error_on_slopes(estimate, ROBOT)
        assert error < 2.5 * predicted_heading_sigma(estimate, 10.0 * DEGREE)
    assert abs(np.mean(ratios)) < 0.025


@pytest.mark.nightly
def test_a_dead_axis_is_not_used():
    """On a slope the body leans all round, which the dead axes say it does not."""
    turned = turn(start_rpy=(0.15, 0.0, 0.3))
    # Without a rest, the robot might as well drive a circle.
    rest = round(3.0 / (turned.time[1] - turned.time[0]))
    time = np.arange(len(turned.time) + rest) * (turned.time[1] - turned.time[0])
    motion = Motion(time, turned.attitude[np.maximum(np.arange(len(time)) - rest, 0)])
    window = measure(ROBOT, motion, np.random.default_rng(4), gyro=True)
    rate = window.angular_rate * [0.0, 0.0, 1.0]
    assert working_axes(rate) == (False, False, True)
    estimate = fit(replace(window, angular_rate=rate), known(ROBOT))
    error = error_of(estimate, ROBOT)
    assert error < 0.5 * DEGREE
    assert error < 3.0 * predicted_heading_sigma(estimate, 0.0)


@pytest.mark.nightly
def test_a_gyro_of_zeros_counts_as_absent(level):
    window, one = level
    other = fit(replace(window, angular_rate=np.zeros((len(window), 3))), known(ROBOT))
    np.testing.assert_array_equal(one.correction.matrix, other.correction.matrix)


@pytest.mark.parametrize(
    ("motion", "reason"),
    [
        (turn(arc=30.0 * DEGREE), Reason.ARC_TOO_SHORT),
        (turn(arc=1e-6), Reason.NO_MOTION),
        (turn(axis=np.array([0.0, math.cos(1.047), -math.sin(1.047)])), Reason.AXIS_ALONG_FIELD),
    ],
    ids=["short", "still", "along the field"],
)  # fmt: skip
def test_turns_with_too_little_information_are_refused(motion: Motion, reason: Reason):
    window = measure(ROBOT, motion, np.random.default_rng(6))
    with pytest.raises(Refusal) as refused:
        fit(window, known(ROBOT))
    assert refused.value.reason is reason


def test_a_rest_beside_a_turn_does_not_wake_silent_axes_of_the_gyro():
    scene, _ = by_rested_turn("even", "typical", "open")(0)
    window = collected(scene.window)
    assert window.rests
    window = replace(window, angular_rate=window.angular_rate * [0.0, 0.0, 1.0])
    assert nodes_of(window, np.eye(3)).working == (False, False, True)
