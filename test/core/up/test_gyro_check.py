import math

import numpy as np
import pytest

from magcal_ros.core.geometry import rotation_from_rpy, unit
from magcal_ros.core.samples import ImuSample
from magcal_ros.core.up import GyroCheck, UpFollower
from magcal_ros.files import read_csv_folder

STEP = 0.04


def nodding(check, sense, seconds=20.0, noise=0.002, seed=1):
    rng = np.random.default_rng(seed)
    for k in range(int(seconds / STEP)):
        angle, rate = 0.15 * math.sin(k * STEP), 0.15 * math.cos(k * STEP)
        force = np.array([0.0, math.sin(angle), math.cos(angle)])
        check.add(tuple(force + noise * rng.standard_normal(3)), (sense * rate * STEP, 0, 0), STEP)


def test_a_gyro_that_agrees_with_the_accelerometer_is_used():
    check = GyroCheck()
    nodding(check, 1.0)
    assert check.is_consistent


def test_a_mirrored_gyro_is_not_used_until_it_is_corrected():
    check = GyroCheck()
    nodding(check, -1.0)
    assert not check.is_consistent
    nodding(check, 1.0, seconds=120.0)
    assert check.is_consistent


def test_a_steady_circle_is_no_evidence():
    check = GyroCheck()
    for _ in range(1000):
        check.add((0.0, 0.15, 1.0), (0.0, 0.0, 0.5 * STEP), STEP)
    assert check.is_consistent


def test_noise_alone_is_no_evidence():
    check = GyroCheck()
    nodding(check, 0.0, noise=0.02)
    assert check.is_consistent


def test_engine_vibration_is_not_taken_for_a_mirrored_gyro(recording):
    """The engine shakes the rate about x by 0.09 rad/s, root mean square."""
    follower = UpFollower()
    for sample in read_csv_folder(recording("car_neu2024_gautham")).samples():
        if isinstance(sample, ImuSample):
            follower.add(sample)
            assert follower.gyro_is_consistent


@pytest.mark.parametrize(("sense", "accepted"), [(1.0, True), (-1.0, False)])
def test_a_tilt_is_evidence_despite_vibration(sense, accepted):
    """The rate about x vibrates at 5 Hz against the force, ten times the rate of the tilt."""
    check, rng = GyroCheck(), np.random.default_rng(2)
    for k in range(1500):
        stamp = k * STEP
        angle, rate = 0.15 * math.sin(stamp), 0.15 * math.cos(stamp)
        shake = 2.0 * math.pi * 4.9 * stamp
        shaking = 0.09 * math.sqrt(2.0) * math.cos(shake)
        force = (0.0, math.sin(angle) + 0.05 * math.cos(shake + 1.5), math.cos(angle))
        turn = (sense * (rate + shaking) + 0.04 * rng.standard_normal()) * STEP
        check.add(force, (turn, 0.0, 0.0), STEP, (0.05 * STEP) ** 2)
    assert check.is_consistent is accepted


@pytest.mark.parametrize(("noise", "is_whole"), [(0.002, False), (0.0, True)])
def test_a_gyro_with_one_working_axis_does_not_rotate_up_about_it(noise, is_whole):
    """In a robot without noise, as simulated, two axes may rest and be right."""
    rng, follower = np.random.default_rng(3), UpFollower()
    lean = 0.0 if is_whole else 0.22
    up = np.array([0.0, math.sin(lean), math.cos(lean)])
    for k in range(1500):
        rate = 0.3 * min(1.0, k * STEP / 2.0)
        rate = 0.0 if k * STEP < 1.0 else rate + noise * rng.standard_normal()
        force = 9.81 * up + 0.05 * rng.standard_normal(3)
        follower.add(ImuSample(k * STEP, tuple(force), (0.0, 0.0, rate * math.cos(lean))))
    assert follower.is_propagated
    assert follower.gyro_is_whole is is_whole
    assert math.degrees(math.acos(min(1.0, float(up @ follower.newest)))) < 2.0


def test_a_gyro_about_up_alone_separates_a_circle_from_a_tilt():
    """A car in circles at 4 m/s: the force leans by 11°, and roads and body tilt by 2°."""
    rng, follower = np.random.default_rng(5), UpFollower()
    mounted = rotation_from_rpy(0.05, -0.08)
    errors = []
    for k in range(4000):
        stamp = 0.025 * k
        rate = 0.5 * np.clip((stamp - 10.0) / 5.0, 0.0, 1.0)
        tilt = 0.035 * np.array([math.sin(0.4 * stamp), math.cos(0.7 * stamp)])
        up = mounted @ unit(np.append(tilt, 1.0))
        force = 9.81 * up + mounted @ [0.0, 4.0 * rate, 0.0] + 0.05 * rng.standard_normal(3)
        turn = float((rate * up)[2]) + 0.002 * rng.standard_normal()
        follower.add(ImuSample(stamp, tuple(force), (0.0, 0.0, turn)))
        errors.append(math.acos(min(1.0, float(up @ follower.newest))))
    assert math.degrees(np.sqrt(np.mean(np.square(errors[1200:])))) < 6.0


def test_without_a_working_axis_near_up_the_force_is_smoothed():
    rng, follower = np.random.default_rng(6), UpFollower()
    for k in range(500):
        rate = (0.01 * rng.standard_normal(), 0.0, 0.0)
        follower.add(ImuSample(0.025 * k, (0.0, 0.0, 9.81), rate))
    assert not follower.gyro_is_whole
    assert not follower.is_propagated


def test_the_sway_of_a_car_driving_straight_hardly_changes_the_bias():
    """Half a second of it is; the sway of one block is not that of the next all over again."""
    worst = np.zeros(4)
    for seed in range(4):
        rng, follower, sway = np.random.default_rng(seed), UpFollower(), np.zeros(3)
        for k in range(1200):
            sway = 0.93 * sway + 0.37 * math.radians(1.0) * rng.standard_normal(3)
            force = np.array([0.0, 0.0, 9.81]) + 0.05 * rng.standard_normal(3)
            follower.add(ImuSample(0.025 * k, tuple(force), tuple(sway)))
            follower.add_field(0.025 * k, (2e-5, 0.0, -4e-5))
            worst[seed] = max(worst[seed], np.linalg.norm(follower.gyro_bias.rate))
    assert worst.mean() < math.radians(1.2)
