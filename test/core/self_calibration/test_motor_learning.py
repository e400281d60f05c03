"""The field of motors is learnt from a drive, and other fields are not attributed to motors."""

import math

import numpy as np
import pytest
from long_form import first_of

from magcal_ros.core import Calibration, Correction
from magcal_ros.core.calibration import INPUTS, Evidence, MotorInput, MotorState
from magcal_ros.core.geometry import exp_rotation, field_in_enu
from magcal_ros.core.heading import MotionDetector
from magcal_ros.core.self_calibration import MotorLearning

STEP = 0.05
MATRIX = np.array([[1.02, 0.02, 0.0], [-0.02, 0.98, 0.03], [0.0, -0.03, 1.0]])
IRON = np.array([12e-6, -7e-6, 4e-6])


def known(sigma=0.3e-6):
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = sigma**2 * np.eye(3)
    evidence = Evidence("x", "good", "good", "Fine.")
    return Calibration(Correction(MATRIX, IRON), covariance, 0.3e-6, 0.01, 48e-6, 1.1, evidence)


def driven(rng, gains, seconds=120.0, current=True):
    """Yield stamps, raw fields, rates and motor states of a robot in stop and go."""
    attitude, begin = np.eye(3), 100.0
    place = np.zeros(3)
    earth = field_in_enu(48e-6, 1.1)
    plan = []
    while len(plan) * STEP < seconds:
        for speed, rate in ((0.0, 0.0), (rng.uniform(0.3, 1.0), 0.0), (0.0, 0.0), (0.0, 0.4)):
            sign = rng.choice([-1.0, 1.0])
            plan += [(speed, sign * rate * rng.uniform(0.5, 2.0))] * int(rng.uniform(2, 5) / STEP)
    for k, (speed, rate) in enumerate(plan):
        attitude = exp_rotation(np.array([0.0, 0.0, -rate * STEP])) @ attitude
        place = place + 0.3e-6 * math.sqrt(2.0 * speed * STEP / 10.0) * rng.standard_normal(3)
        moves = float(speed > 0.0 or rate != 0.0)
        ampere = moves * (1.0 + 2.0 * speed) * (1.0 + 0.3 * math.sin(2.0 * k * STEP))
        side = math.copysign(1.0, rate) if rate else 0.0
        now = MotorState(moves, rate, speed, ampere if current else math.nan, side)
        added = sum(np.array(g) * now.values[INPUTS.index(name)] for name, g in gains.items())
        raw = np.linalg.solve(MATRIX, attitude @ (earth + place)) + IRON + added
        raw = raw + 0.3e-6 * rng.standard_normal(3)
        yield begin + k * STEP, tuple(raw), (0.0, 0.0, rate), now


def learnt(gains, seed=0, **options):
    learning = MotorLearning(known())
    for sample in driven(np.random.default_rng(seed), gains, **options):
        learning.add(*sample)
    return learning.motors


CASES = {
    "none": {},
    "step": {"moving": (6e-6, -4e-6, 1e-6)},
    "speed": {"speed": (6e-6, -4e-6, 1e-6)},
    "turn rate": {"turn_rate": (6e-6, -4e-6, 1e-6)},
    "turn rate to either side": {"abs_turn_rate": (6e-6, -4e-6, 1e-6)},
    "current": {"current": (3e-6, -4e-6, 1e-6)},
    "side": {"side": (6e-6, -4e-6, 1e-6)},
}


@pytest.mark.parametrize("name", first_of(CASES, 3))
def test_the_field_is_found_for_every_motion(name):
    motors = learnt(CASES[name])
    for now in (
        MotorState(1.0, 0.0, 0.6, 2.2),
        MotorState(1.0, 0.5, 0.0, 1.0, 1.0),
        MotorState(1.0, -0.5, 0.0, 1.0, -1.0),
    ):
        u, _ = motors.known(now)
        wide = np.kron(u, np.eye(3))
        sigma = np.sqrt(np.diag(wide @ motors.covariance @ wide.T))
        gains = CASES[name].items()
        true = sum((np.array(g) * now.values[INPUTS.index(k)] for k, g in gains), np.zeros(3))
        assert (np.abs(u @ motors.gain - true) < 4.0 * sigma + 0.02e-6).all()
        assert (sigma < 0.6e-6).all()


def test_an_irrelevant_input_has_a_gain_near_zero_within_its_sigma():
    motors = learnt({})
    for k, each in enumerate(motors.inputs):
        assert motors.size(k) < 0.15e-6, each
        assert 0.0 < motors.sigma(k) * motors.usual[k] < 0.6e-6, each


def test_only_measured_inputs_are_named():
    motors = learnt(CASES["step"], current=False)
    assert set(motors.inputs) == set(MotorInput) - {MotorInput.CURRENT}


@pytest.mark.parametrize("is_silent_at_rest", [False, True])
def test_the_field_is_learnt_without_a_battery(is_silent_at_rest):
    learning, sense = MotorLearning(known()), MotionDetector()
    for stamp, raw, rate, now in driven(np.random.default_rng(3), CASES["speed"]):
        rests = now.moving == 0.0
        speed = math.nan if rests and is_silent_at_rest else now.speed
        learning.add(stamp, raw, rate, sense.at(stamp, rate, rests, speed, math.nan))
    motors = learning.motors
    assert MotorInput.CURRENT not in motors.inputs
    # It drives forwards alone.
    both = [motors.inputs.index(each) for each in (MotorInput.SPEED, MotorInput.ABS_SPEED)]
    off = np.linalg.norm(motors.gain[both].sum(axis=0) - CASES["speed"]["speed"])
    sum_ = np.kron([float(k in both) for k in range(len(motors.inputs))], np.eye(3))
    sigma = math.sqrt(np.trace(sum_ @ motors.covariance @ sum_.T))
    assert off < 4.0 * sigma < 2e-6


def test_before_the_first_start_an_input_may_be_anything():
    learning = MotorLearning(known())
    for k in range(200):
        raw = tuple(np.linalg.solve(MATRIX, field_in_enu(48e-6, 1.1)) + IRON)
        learning.add(k * STEP, raw, (0.0, 0.0, 0.0), MotorState())
    motors = learning.motors
    at = motors.inputs.index(MotorInput.SPEED)
    assert motors.sigma(at) * motors.usual[at] > 1.5e-6


def test_a_jump_of_time_does_no_harm():
    learning = MotorLearning(known())
    for sample in driven(np.random.default_rng(1), CASES["step"], seconds=60.0):
        learning.add(*sample)
    before = learning.motors.gain
    learning.add(5.0, (0.0, 0.0, 5e-5), (0.0, 0.0, 0.0), MotorState())
    assert np.allclose(learning.motors.gain, before)


@pytest.mark.parametrize("late", [0.0, 0.25])
def test_the_latency_of_a_current_is_found_with_its_gain(late):
    gain, learning = np.array([3e-6, -4e-6, 1e-6]), MotorLearning(known())
    drive = list(driven(np.random.default_rng(2), {"current": gain}))
    for k, (stamp, raw, rate, now) in enumerate(drive):
        reported = drive[max(k - round(late / STEP), 0)][3].current if now.moving else 0.0
        beside = {each[3].moving for each in drive[max(k - 6, 0) : k + 7]}
        # Nobody knows exactly when a robot starts and stops.
        moving = now.moving if len(beside) == 1 else 0.5
        learning.add(stamp, raw, rate, now._replace(current=reported, moving=moving))
    found, sigma = learning.delay
    assert abs(found - late) < 4.0 * sigma + 0.02
    assert sigma < 0.03
    motors = learning.motors
    at = motors.inputs.index(MotorInput.CURRENT)
    assert np.linalg.norm(motors.gain[at] - gain) < 4.0 * motors.sigma(at) + 0.1e-6
