"""Comparison of gyro and commands with the field: many rooms, speeds and faults."""

import math

import numpy as np
import pytest
from long_form import first_of

from magcal_ros.core.session import fit_circle_by_angle, objection_to_gyro

RATE = 50.0


def drive(seed, speed=0.5, gain=1.0, noise=0.5e-6, soft_iron=0.0, radius=20e-6, lag=0.15):
    """A ramp and a steady turn of a robot: true and commanded angle, and its level field."""
    rng = np.random.default_rng(seed)
    time = np.arange(int(7.0 / speed * RATE)) / RATE
    command = np.minimum(0.5 * time, speed)
    rate = np.zeros_like(time)
    for k in range(1, len(time)):
        rate[k] = rate[k - 1] + (gain * command[k - 1] - rate[k - 1]) / RATE / lag
    angle = np.cumsum(rate) / RATE
    phase, axis = rng.uniform(0.0, math.tau, 2)
    level = radius * np.column_stack([np.cos(phase - angle), np.sin(phase - angle)])
    turn = np.array([[math.cos(axis), -math.sin(axis)], [math.sin(axis), math.cos(axis)]])
    level = level @ turn @ np.diag([1.0 + soft_iron, 1.0]) @ turn.T
    level += rng.uniform(-30e-6, 30e-6, 2) + noise * rng.standard_normal(level.shape)
    return rate, angle, np.cumsum(command) / RATE, level, rng


@pytest.mark.parametrize("seed", first_of(range(6)))
@pytest.mark.parametrize(
    "world",
    [
        {},
        {"soft_iron": 0.5},
        {"gain": 0.6},
        {"gain": 1.4},
        {"noise": 2e-6},
        {"speed": 0.1},
        {"speed": 1.0},
        {"lag": 0.5},
    ],
    ids=str,
)
def test_a_correct_gyro_is_never_rejected(seed, world):
    rate, angle, reported, level, rng = drive(seed, **world)
    gyro = angle + np.cumsum(0.003 * rng.standard_normal(len(rate)) + 0.01) / RATE
    for end in range(20, len(rate), 25):
        assert not objection_to_gyro(gyro[:end], reported[:end], level[:end])


@pytest.mark.parametrize("seed", first_of(range(6)))
@pytest.mark.parametrize("hangs_at", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("world", [{}, {"gain": 0.8}, {"noise": 1e-6}], ids=str)
def test_a_frozen_gyro_is_rejected_within_a_quarter_turn(seed, hangs_at, world):
    rate, _, reported, level, _ = drive(seed, **world)
    gyro = np.cumsum(np.minimum(rate, hangs_at)) / RATE
    end = int(np.searchsorted(reported, math.radians(100.0)))
    found = [objection_to_gyro(gyro[:k], reported[:k], level[:k]) for k in range(20, end, 12)]
    assert any("the field turned by" in words for words in found) or hangs_at == 0.2
    late = int(np.searchsorted(reported, math.radians(330.0)))
    assert objection_to_gyro(gyro[:late], reported[:late], level[:late])


def test_a_gyro_that_measures_a_turn_of_a_robot_at_rest_is_rejected():
    _, _, reported, level, _ = drive(1, gain=0.0)
    assert "the field did not change" in objection_to_gyro(reported, reported, level)


def test_without_enough_samples_there_is_no_objection():
    _, angle, reported, level, _ = drive(1)
    assert not objection_to_gyro(angle[:5], reported[:5], level[:5])
    assert not objection_to_gyro(0.0 * angle[:40], reported[:40], level[:40])


def test_the_fit_finds_the_circle():
    _, angle, _, level, _ = drive(2, noise=0.0)
    rest, radius = fit_circle_by_angle(angle, level)
    assert rest < 1e-20
    assert radius == pytest.approx(20e-6, rel=1e-6)
