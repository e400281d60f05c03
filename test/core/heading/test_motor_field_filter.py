"""The field of motors before an input shows it: that of a place cannot change so fast."""

from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of

from magcal_ros.core.calibration import AT_REST, MotorField, MotorInput, MotorState
from magcal_ros.core.geometry import exp_rotation
from magcal_ros.core.heading import UNSEEN, MotorFieldFilter

PERIOD, NOISE, RATE = 0.04, 0.2e-6, (0.0, 0.0, 0.4)
EARTH = np.array([18e-6, 5e-6, -42e-6])
STEP = np.array([6e-6, -8e-6, 3e-6])
BY_CURRENT = np.array([2e-6, 1.5e-6, -1e-6])


def motors(ripple=0.2e-6):
    inputs = MotorInput.MOVING, MotorInput.CURRENT
    covariance = np.diag([0.1e-6**2] * 3 + [0.05e-6**2] * 3)
    gain = np.array([STEP, BY_CURRENT])
    return MotorField(inputs, gain, covariance, np.zeros((12, 6)), ripple, (1.0, 3.0))


def follower(known, iron=(0.2e-6) ** 2 * np.eye(3)):
    return MotorFieldFilter(known, np.eye(3), iron, NOISE**2 * np.eye(3))


def errors(known, reported, added, turns, seed=0, now=None):
    """Errors of the field of the place, and its sigmas, shape (n, 3)."""
    rng, now = np.random.default_rng(seed), now or follower(known)
    field, off, sigma = EARTH, [], []
    for k, (motor_state, more, is_turning) in enumerate(zip(reported, added, turns, strict=True)):
        rate = np.array(RATE) * is_turning
        field = exp_rotation(-rate * PERIOD) @ field
        noise = NOISE * rng.standard_normal(3)
        found, doubt = now.add(k * PERIOD, tuple(field + more + noise), tuple(rate), motor_state)
        off.append(np.array(found) - field)
        sigma.append(np.sqrt(np.diag(doubt.lasting + doubt.noise)))
    return np.array(off), np.array(sigma)


@pytest.mark.parametrize("late", first_of([0.2, -0.2, 0.0], 2))
def test_start_and_stop_may_be_detected_late_or_early(late):
    stamps = np.arange(300) * PERIOD
    runs = (stamps > 4.0) & (stamps < 8.0)
    shows = (stamps > 4.0 + late) & (stamps < 8.0 + late)
    reported = [MotorState(1.0, 0.4, 0.0, 0.0, 1.0) if each else AT_REST for each in shows]
    off, sigma = errors(motors(), reported, np.outer(runs, STEP), runs)
    assert np.linalg.norm(off, axis=1).max() < 0.2 * np.linalg.norm(STEP)
    assert np.mean((off / np.maximum(sigma, 0.05e-6)) ** 2) < 2.0


@pytest.mark.parametrize("first", first_of(range(100, 106), 2))
def test_a_start_that_no_input_shows_is_seen_at_once(first):
    """Within a block of samples and at its edge."""
    runs = np.arange(300) >= first
    reported = [
        MotorState(1.0, 0.4, 0.0, 0.0, 1.0) if k >= first + 5 else AT_REST for k in range(300)
    ]
    off, sigma = errors(motors(), reported, np.outer(runs, STEP), runs)
    assert np.linalg.norm(off, axis=1).max() < 0.1 * np.linalg.norm(STEP)
    assert np.mean((off / sigma) ** 2) < 1.2


def test_ripple_and_latency_of_a_current_are_compensated():
    rng = np.random.default_rng(1)
    stamps = np.arange(500) * PERIOD
    ripple = np.convolve(rng.standard_normal(520), np.ones(10) / np.sqrt(10.0))[:500]
    current = np.where(stamps > 2.0, 3.0 + ripple, 0.0)
    late = np.concatenate([np.zeros(5), current[:-5]])
    reported = [
        MotorState(float(t > 2.0), 0.4, 0.0, c, 1.0) for t, c in zip(stamps, late, strict=True)
    ]
    added = np.outer(stamps > 2.0, STEP) + np.outer(current, BY_CURRENT)
    off, sigma = errors(motors(1e-6), reported, added, stamps > 2.0)
    plain = np.outer(current - late, BY_CURRENT)
    assert np.sqrt(np.mean(off**2)) < 0.5 * np.sqrt(np.mean(plain**2))
    assert np.mean((off / np.maximum(sigma, 0.05e-6)) ** 2) < 2.0


@pytest.mark.parametrize("seed", first_of(range(3)))
def test_a_start_before_its_current_is_not_taken_for_the_place(seed):
    stamps = np.arange(150) * PERIOD
    flows = np.where(stamps > 4.0, 2.0, 0.0)
    reported = [
        MotorState(
            float(np.interp(t, [4.04, 4.06, 4.14, 4.16], [0.0, 0.5, 0.5, 1.0])), 0.02, 0.0, c
        )
        for t, c in zip(stamps, np.where(stamps > 4.2, 2.0, 0.0), strict=True)
    ]
    known = replace(motors(), gain=np.array([np.zeros(3), BY_CURRENT]))
    off, sigma = errors(known, reported, np.outer(flows, BY_CURRENT), np.zeros(150), seed)
    begins = (stamps > 4.04) & (stamps < 4.2)
    assert np.abs(off[begins]).max() < 0.25 * 2.0 * np.linalg.norm(BY_CURRENT)
    assert np.mean((off / np.maximum(sigma, 0.05e-6)) ** 2) < 2.0


@pytest.mark.nightly
@pytest.mark.parametrize("holding", first_of([2.0, 0.0, 4.0]))
def test_a_battery_silent_at_rest_leaves_the_hold_current_uncertain(holding):
    known = replace(motors(), reference=-0.5)
    reported = [MotorState(0.0, 0.0, 0.0, np.nan, 0.0)] * 400
    added = np.tile(holding * BY_CURRENT, (400, 1))
    off, sigma = errors(known, reported, added, np.zeros(400))
    assert (sigma > 0.9 * known.usual[1] * np.abs(BY_CURRENT)).all()
    assert np.mean((off / sigma) ** 2) < 2.0
    # A robot that is calibrated at rest, whatever its current is then, is at its reference.
    _, sure = errors(motors(), reported, added, np.zeros(400))
    assert sure[5:].max() < 2.0 * NOISE


@pytest.mark.parametrize("later", first_of([4.0, 2.0]))
def test_a_battery_that_stops_at_rest_keeps_the_field_of_the_place(later):
    """Also if the motors hold the robot by another current later on."""
    known = replace(motors(), reference=-0.5)
    reported = [MotorState(0.0, 0.0, 0.0, 2.0 if k < 200 else np.nan, 0.0) for k in range(600)]
    current = np.where(np.arange(600) < 400, 2.0, later)
    off, sigma = errors(known, reported, np.outer(current, BY_CURRENT), np.zeros(600))
    after = np.r_[200:400, 420:600]
    assert np.linalg.norm(off[after], axis=1).max() < 1.2e-6
    assert np.mean((off[after] / sigma[after]) ** 2) < 1.5


@pytest.mark.nightly
@pytest.mark.parametrize("seed", first_of(range(6)))
def test_an_unreported_current_differs_from_the_speed(seed):
    rng = np.random.default_rng(seed)
    inputs, gain = (MotorInput.ABS_SPEED,), 2.0 * STEP[None]
    known = MotorField(inputs, gain, 1e-14 * np.eye(3), np.zeros((12, 3)), 0.3e-6, (1.0,))
    stamps = np.arange(1000) * PERIOD
    speed = np.where(stamps > 2.0, 1.0 + 0.3 * np.sin(stamps), 0.0)
    varies = np.convolve(rng.standard_normal(1020), np.ones(12) / np.sqrt(12.0))[:1000]
    reported = [MotorState(float(each > 0.0), 0.4, each, np.nan, 1.0) for each in speed]
    off, sigma = errors(
        known, reported, np.outer((1.0 + 0.2 * varies) * speed, gain), stamps > 2.0, seed
    )
    plain = np.outer(0.2 * varies * speed, gain)
    assert np.sqrt(np.mean(off**2)) < 0.5 * np.sqrt(np.mean(plain**2))
    assert np.mean((off[60:] / sigma[60:]) ** 2) < 1.5


def turning(seconds):
    """A robot that stands for two seconds and then turns."""
    stamps = np.arange(int(seconds / PERIOD)) * PERIOD
    runs = stamps > 2.0
    reported = [MotorState(1.0, 0.4, 0.0, 0.0, 1.0) if each else AT_REST for each in runs]
    return stamps, runs, reported


def test_inputs_that_explain_the_motors_soon_reduce_the_residual():
    """They may differ from what inputs show, but by how much is learnt."""
    stamps, runs, reported = turning(30.0)
    now = follower(motors())
    found = errors(motors(), reported, np.outer(runs, STEP), runs, now=now)
    assert now.odds @ UNSEEN < 0.05
    off, sigma = (each[stamps > 10.0] for each in found)
    assert sigma.max() < 0.04 * np.linalg.norm(STEP)
    assert 0.4 < np.mean((off / sigma) ** 2) < 1.5


def test_noise_that_is_subtracted_with_unknown_motors_is_counted_once():
    """Right after a start the place is known better than a sample shows it."""
    known = replace(motors(), covariance=(5e-6) ** 2 * np.eye(6))
    stamps, runs, reported = turning(2.5)
    steps = STEP + np.random.default_rng(9).normal(0.0, 5e-6, (12, 3))
    found = [errors(known, reported, np.outer(runs, s), runs, k) for k, s in enumerate(steps)]
    soon = (stamps > 2.1) & (stamps < 2.4)
    off, sigma = (np.concatenate([each[k][soon] for each in found]) for k in (0, 1))
    assert sigma.max() < 1.3 * NOISE
    assert np.mean((off / sigma) ** 2) < 1.4


def test_iron_along_the_axis_does_not_change_the_field_of_a_robot_that_turns():
    _, runs, reported = turning(12.0)
    sigmas = [
        errors(motors(), reported, np.outer(runs, STEP), runs, now=follower(motors(), iron))[1]
        for iron in (np.zeros((3, 3)), np.diag([0.0, 0.0, 3e-6]) ** 2)
    ]
    assert np.allclose(*sigmas, rtol=1e-9)


def test_another_place_is_soon_distinguished_from_motors():
    """A permanent change of the field at rest, like one by motors."""
    stamps = np.arange(100) * PERIOD
    now, off = follower(motors()), []
    for k, stamp in enumerate(stamps):
        field = EARTH + STEP * (stamp > 2.0)
        found, _ = now.add(k * PERIOD, tuple(field), (0.0, 0.0, 0.0), AT_REST)
        off.append(np.linalg.norm(np.array(found) - field))
    assert max(off[: int(2.0 / PERIOD)]) < 0.1e-6
    assert max(off[int(2.7 / PERIOD) :]) < 0.1e-6


def test_motors_below_the_noise_do_not_change_a_robot_at_rest():
    inputs = (MotorInput.MOVING,)
    none = MotorField(inputs, np.zeros((1, 3)), np.zeros((3, 3)), np.zeros((12, 3)), 0.0, (1.0,))
    field = (1e-5, 2e-5, -4e-5)
    found, doubt = follower(none).add(0.0, field, (0.0, 0.0, 0.0), AT_REST)
    assert found == field
    assert not doubt.lasting.any()
