import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated.turns import measure, turn

from magcal_ros.core.geometry import (
    STANDARD_GRAVITY,
    rotation_from_rpy,
    wrap_angle,
    yaw_from_up_and_field,
)
from magcal_ros.core.samples import FieldSample, ImuSample
from magcal_ros.core.simulation import Ride, Robot

SILENT = {"noise_field": 0.0, "noise_force": 0.0, "noise_rate": 0.0}
PERFECT = Robot(declination=0.2, gyro_bias=np.array([0.01, -0.02, 0.03]), **SILENT)


def ride(robot=PERFECT, **options):
    return Ride(robot, np.random.default_rng(1), start=50.0, **options)


def run(one, steps, yaw_rate=0.0):
    samples = [sample for _ in range(steps) for sample in one.step(yaw_rate)]
    imus = [sample for sample in samples if isinstance(sample, ImuSample)]
    return imus, [sample for sample in samples if isinstance(sample, FieldSample)]


def test_a_turn_gives_the_measurements_of_the_simulator():
    """Two ways to one truth: small steps, and attitudes in closed form."""
    start, rate = (0.15, -0.1, 2.0), 0.6
    one = ride(steps_per_field=1)
    one.stand(*start)
    imus, fields = run(one, 700, rate)
    motion = turn(arc=rate * 7.0, samples=701, duration=7.01, start_rpy=start)
    truth = measure(PERFECT, motion, np.random.default_rng(1), gyro=True)
    assert np.array([s.field for s in fields]) == pytest.approx(truth.field[1:], abs=1e-12)
    forces = np.array([s.force for s in imus])
    assert forces == pytest.approx(truth.specific_force[1:], abs=1e-9)
    rates = np.array([s.rate for s in imus])
    assert rates[:-1] == pytest.approx(truth.angular_rate[1:-1], abs=2e-3)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-math.pi, math.pi))
def test_a_robot_set_down_shows_its_pose(roll, pitch, yaw):
    one = ride(steps_per_field=1)
    one.stand(roll, pitch, yaw)
    (imu,), (field,) = run(one, 1)
    up = rotation_from_rpy(roll, pitch, yaw).T[:, 2]
    assert imu.force == pytest.approx(STANDARD_GRAVITY * up, abs=1e-9)
    found = yaw_from_up_and_field(
        np.array(imu.force), PERFECT.true_correction.apply(np.array(field.field))
    )
    assert abs(wrap_angle(found - one.magnetic_yaw)) < 1e-9
    assert abs(wrap_angle(one.magnetic_yaw - (yaw + PERFECT.declination))) < 1e-9


@pytest.mark.parametrize("rate", [0.5, -0.5])
def test_a_turn_to_the_left_increases_yaw_and_gyro_z(rate):
    one = ride()
    before = one.magnetic_yaw
    imus, _ = run(one, 200, rate)
    assert wrap_angle(one.magnetic_yaw - before) == pytest.approx(2.0 * rate, abs=1e-9)
    assert imus[-1].rate == pytest.approx(PERFECT.gyro_bias + np.array([0.0, 0.0, rate]))


def test_the_robot_turns_about_the_given_axis():
    one = ride()
    one.axis = np.array([0.0, math.sin(0.3), math.cos(0.3)])
    imus, _ = run(one, 300, 0.4)
    along = [np.dot(sample.force, one.axis) for sample in imus]
    assert np.ptp(along) < 1e-9
    assert np.ptp([sample.force[0] for sample in imus]) > 1.0


def test_stamps_follow_the_rates():
    imus, fields = run(ride(imu_rate=200.0, steps_per_field=4), 400)
    assert np.diff([s.stamp for s in imus]) == pytest.approx(0.005)
    assert np.diff([s.stamp for s in fields]) == pytest.approx(0.02)
    assert (imus[0].stamp, fields[0].stamp) == pytest.approx((50.005, 50.005))
    assert len(fields) == 100


def test_without_a_gyro_the_rates_are_nan():
    imus, _ = run(ride(gyro=False), 5)
    assert np.isnan([s.rate for s in imus]).all()
    assert np.isfinite([s.force for s in imus]).all()


def test_the_noise_has_the_sizes_of_the_robot():
    robot = Robot(noise_field=0.7e-6, noise_force=0.2, noise_rate=0.03)
    imus, fields = run(ride(robot, steps_per_field=1), 4000)
    assert np.std([s.field for s in fields], axis=0) == pytest.approx(0.7e-6, rel=0.05)
    assert np.std([s.force for s in imus], axis=0) == pytest.approx(0.2, rel=0.05)
    assert np.std([s.rate for s in imus], axis=0) == pytest.approx(0.03, rel=0.05)
