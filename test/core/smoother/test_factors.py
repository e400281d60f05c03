"""Every derivative against a difference quotient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from simulated.turns import measure, turn

from magcal_ros.core.geometry import minimal_rotation, rotation_about, unit
from magcal_ros.core.simulation import Robot
from magcal_ros.core.smoother import (
    ACCELERATION,
    AT,
    ATTITUDE,
    CURRENT_LATE,
    LOCAL,
    RATE,
    SHARED,
    STREET,
    VELOCITY,
    Course,
    Lengths,
    Places,
    Residuals,
    State,
    factors,
    factors_of_motion,
    nodes_of,
    priors_of,
)

STEP = 1e-6


@pytest.fixture(scope="module")
def course() -> Course:
    window = measure(Robot(), turn(samples=60, duration=6.0), np.random.default_rng(3), gyro=True)
    stamps = np.arange(window.time[0], window.time[-1] + 0.1, 0.1)
    # Smooth, as the derivative by its delay is a mean over some hundredths of a second.
    currents = -2.0 + 1.5 * np.sin(stamps)
    window = window.with_battery(np.column_stack([stamps, currents]))
    axes = np.linalg.qr(np.random.default_rng(4).standard_normal((3, 3)))[0]
    return Course.of(nodes_of(window, np.eye(3)), axes, np.zeros(3), Lengths())


def turn_axes(course: Course) -> np.ndarray:
    """Return axes of which the last one is the turn's."""
    return minimal_rotation(np.array([0.0, 0.0, 1.0]), unit(course.nodes.rate.mean(axis=0)))


@pytest.fixture(scope="module")
def state(course: Course) -> State:
    """Return a state near the gyro's path, so that what is left of the rotations is small."""
    rng = np.random.default_rng(5)
    nodes = course.nodes
    attitude = [np.eye(3)]
    for turned in nodes.turned:
        attitude.append(turned @ attitude[-1])
    local = 0.3 * rng.standard_normal((len(nodes), LOCAL))
    local[:, ATTITUDE] = 0.0
    local[:, RATE] = nodes.rate @ turn_axes(course)[:, 2:] + 0.01 * local[:, RATE]
    shared = priors_of(Robot().knowledge()).mean + 1e-3 * rng.standard_normal(SHARED)
    shared[AT["motors_current"]] = [1.0, -2.0, 0.5]
    return State(np.array(attitude), local, shared, rng.standard_normal((4, 3)))


def places(count: int) -> Places:
    weights = np.random.default_rng(6).uniform(0.0, 0.5, (count, 4))
    return Places(
        weights,
        np.arange(4),
        np.linspace(0.2, 1.0, count),
        np.eye(4),
        0.0,
        30.0,
        np.ones(count, bool),
    )


def magnetic(course: Course, state: State) -> Residuals:
    return factors.magnetic(course, state, places(len(course.nodes)))


def process(_: Course, state: State) -> Residuals:
    return factors.process(state, STREET, np.full(len(state.local) - 1, 0.7))


def forward(count: int) -> np.ndarray:
    return np.tile([0.8, 0.5, 0.1], (count, 1))


def followed(_: Course, state: State) -> Residuals:
    correlation = np.linspace(0.1, 0.9, 2 * (len(state.local) - 1)).reshape(2, -1)
    return factors.second_order(
        state, ACCELERATION.start, correlation, (VELOCITY.start, ACCELERATION.start)
    )


def known_heading(_: Course, state: State) -> Residuals:
    count = len(state.local)
    return factors.known_heading(np.linspace(0.0, 1.0, count), forward(count), state)


def known_turn(_: Course, state: State) -> Residuals:
    count = len(state.local)
    turned, seconds = np.linspace([0.0, 3.0], [0.1, 7.0], count - 1).T
    return factors.known_turn(turned, seconds, forward(count), state)


def force_at_rest(_: Course, state: State) -> Residuals:
    return factors.force_at_rest(np.tile([0.3, -0.2, 9.7], (len(state.local), 1)), state)


def turning(course: Course, state: State) -> Residuals:
    return factors_of_motion.turning(course, state, turn_axes(course))


def lean(course: Course, state: State) -> Residuals:
    axes = np.linalg.qr(np.random.default_rng(7).standard_normal((3, 3)))[0]
    return factors_of_motion.lean(state, axes, np.full(len(state.local) - 1, 0.7))


def speed_ahead(_: Course, state: State) -> Residuals:
    return factors_of_motion.speed(np.linspace(0.5, 2.0, len(state.local)), state, is_ahead=True)


def speed_any_way(_: Course, state: State) -> Residuals:
    return factors_of_motion.speed(np.linspace(0.5, 2.0, len(state.local)), state, is_ahead=False)


BY_SHARED = (
    *(magnetic, factors_of_motion.force, factors_of_motion.gyro, force_at_rest),
    *(factors_of_motion.force_at_nodes, factors_of_motion.sway, turning, lean),
    known_turn,
)
FACTORS = (*BY_SHARED, process, followed, known_heading, speed_ahead, speed_any_way)


def change(factor, course: Course, state: State, local, shared) -> np.ndarray:
    """Return the derivative of a prediction along a step."""

    def at(sign: float) -> np.ndarray:
        by_force = factor in (factors_of_motion.force, factors_of_motion.force_at_nodes)
        ahead = sign * STEP * shared[AT["mounting_yaw"]] * by_force
        turned = replace(course, axes=course.axes @ rotation_about(factors.Z, ahead)[0])
        return factor(turned, state.moved(sign * STEP * local, sign * STEP * shared)).residual

    return (at(-1.0) - at(1.0)) / (2.0 * STEP)


@pytest.mark.parametrize("factor", FACTORS, ids=lambda f: f.__name__)
def test_derivatives_by_unknowns_of_nodes_are_correct(
    course: Course, state: State, factor: Callable[[Course, State], Residuals]
) -> None:
    linear = factor(course, state)
    by_node, by_next = np.zeros((2, *linear.residual.shape, LOCAL))
    factors.put(by_node, linear.node)
    factors.put(by_next, linear.later)
    scale = max(np.abs(by_node).max(), 1.0)
    count, none = len(linear.residual), np.zeros(SHARED + 12)
    for unknown in range(LOCAL):
        for parity in (0, 1):
            local = np.zeros((len(state.local), LOCAL))
            local[parity::2, unknown] = 1.0
            expected = np.zeros_like(linear.residual)
            expected[parity::2] = by_node[parity::2, :, unknown]
            rows = np.arange(1 - parity, count, 2)
            expected[rows] += by_next[rows, :, unknown]
            found = change(factor, course, state, local, none)
            np.testing.assert_allclose(found, expected, atol=1e-3 * scale)


@pytest.mark.parametrize("factor", BY_SHARED, ids=lambda f: f.__name__)
def test_derivatives_by_shared_unknowns_are_correct(
    course: Course, state: State, factor: Callable[[Course, State], Residuals]
) -> None:
    linear = factor(course, state)
    by_shared = linear.by(np.arange(SHARED + 12))
    scale = max(np.abs(by_shared).max(), 1.0)
    local = np.zeros((len(state.local), LOCAL))
    for unknown in range(SHARED + 12):
        shared = np.zeros(SHARED + 12)
        shared[unknown] = 1.0
        found = change(factor, course, state, local, shared)
        expected = by_shared[:, :, unknown]
        # What battery and gyro did before the window and after it is not known.
        rows = slice(4, -4) if unknown == CURRENT_LATE else slice(None)
        np.testing.assert_allclose(found[rows], expected[rows], atol=1e-3 * scale)
