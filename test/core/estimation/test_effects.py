"""What follows the turn rate: its shape against physics, and how much of it a turn shows."""

from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from uneven_turns import (
    REST,
    ROBOT,
    collected,
    driven,
    evenly,
    stop_and_go,
    there_and_back,
    unevenly,
)

from magcal_ros.core.estimation.effects import Effect, effects_of_rate
from magcal_ros.core.estimation.gyro_attitude import GyroBlock
from magcal_ros.core.estimation.gyro_path import gyro_path
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.core.knowledge import Systematics
from magcal_ros.core.methods.maximum_likelihood.fit import solve

KNOWN = replace(ROBOT.knowledge(1.5e-6, 0.02), systematics=Systematics())
ARM = np.array([0.3, -0.4, 0.0])


def late(window, seconds):
    time = window.time
    columns = [np.interp(time - seconds, time, window.field[:, k]) for k in range(3)]
    return replace(window, field=np.column_stack(columns))


def beside_the_axis(motion, window, arm):
    rate = motion.angular_rate
    swing = np.gradient(rate, motion.time, axis=0)
    force = np.cross(rate, np.cross(rate, arm)) + np.cross(swing, arm)
    return replace(window, specific_force=window.specific_force + force)


def found(window):
    """The effects of rate that a turn shows, by kind."""
    block = solve(collected(window), KNOWN).choice.fit.block
    assert isinstance(block, GyroBlock)
    return {kind: block.path.found(block.errors, kind) for kind in block.path.effects.kinds}


def test_columns_are_what_physics_adds():
    quiet = replace(ROBOT, noise_field=0.0, noise_force=0.0, noise_rate=0.0)
    motion, window = driven(unevenly, quiet)
    path = gyro_path(window, np.arange(len(window)))
    raw = window.field - quiet.hard_iron
    effects = effects_of_rate(path.pace, raw, quiet.distortion)
    inside = slice(30, -30)
    shift = late(window, 0.01).field - window.field
    column = 0.01 * effects.only(Effect.LATENCY).columns[:, 3:, 0]
    np.testing.assert_allclose(shift[inside], column[inside], atol=0.1 * np.abs(shift).max())
    pull = beside_the_axis(motion, window, ARM).specific_force - window.specific_force
    lean = STANDARD_GRAVITY * effects.only(Effect.LEVER_ARM).columns[:, :3] @ ARM
    # The sway has rates of its own, which a slow pace leaves out.
    lean, pull = (values[inside, :2].mean(axis=0) for values in (lean, pull))
    np.testing.assert_allclose(lean, pull, atol=8e-3)
    motors = effects.only(Effect.MOTORS).columns
    np.testing.assert_allclose(motors.mean(axis=0), 0.0, atol=1e-12)


@pytest.mark.parametrize("course", first_of([stop_and_go, evenly, unevenly]))
def test_a_field_that_comes_late_is_seen(course):
    seen = found(late(driven(course)[1], 0.05))
    assert set(seen) == {Effect.LATENCY}
    assert seen[Effect.LATENCY][0] == pytest.approx(0.05, abs=0.008)


def test_an_accelerometer_beside_the_axis_is_seen():
    motion, window = driven(unevenly)
    seen = found(beside_the_axis(motion, window, ARM))
    assert set(seen) == {Effect.LEVER_ARM}
    np.testing.assert_allclose(seen[Effect.LEVER_ARM][:2], ARM[:2], atol=0.15)


def test_motors_that_follow_the_speed_are_seen():
    motion, window = driven(unevenly)
    current = np.outer(motion.angular_rate[:, 2] / 0.33, [0.0, 2e-6, 0.0])
    solved = solve(collected(replace(window, field=window.field + current)), KNOWN)
    assert set(solved.choice.fit.block.path.effects.kinds) == {Effect.MOTORS}
    assert np.linalg.norm(solved.motors) == pytest.approx(np.abs(current).max() / 2.0, rel=0.5)


@pytest.mark.parametrize("seed", first_of([1, 2, 3, 4]))
def test_axes_out_of_square_are_no_motors_where_the_rate_follows_the_heading(seed):
    _, window = driven(there_and_back, seed=seed)
    axes = 0.015 * np.random.default_rng(seed).standard_normal((3, 3))
    raw = window.field + (window.field - ROBOT.hard_iron) @ axes.T
    assert Effect.MOTORS not in found(replace(window, field=raw))


@pytest.mark.parametrize("course", first_of([stop_and_go, evenly, unevenly]))
def test_good_sensors_show_nothing(course):
    for seed in range(2):
        assert found(driven(course, seed=seed)[1]) == {}


def test_a_cars_circle_is_no_lever_arm():
    motion, window = driven(unevenly, rest=0.5 * REST)
    pull = beside_the_axis(motion, window, np.array([0.0, -15.0, 0.0]))
    assert Effect.LEVER_ARM not in found(pull)
