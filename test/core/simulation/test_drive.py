"""A simulated drive obeys physics: its measurements follow from the truth."""

import dataclasses
import math

import numpy as np
import pytest
from simulated import (
    Body,
    Fence,
    Iron,
    Leg,
    Receiver,
    StreetField,
    Streets,
    Vehicle,
    Wheels,
    circles,
    city,
    one_street,
    parking,
    reversing,
    simulated_drive,
    travel,
)

from magcal_ros.core.geometry import STANDARD_GRAVITY, wrap_angle, yaw_from_up_and_field
from magcal_ros.core.samples import FieldSample, ImuSample, SpeedSample
from magcal_ros.core.simulation import DEGREE, Robot

QUIET = Vehicle(
    Robot(noise_force=0.0, noise_rate=0.0, noise_field=0.0, declination=4.0 * DEGREE),
    imu_yaw=20.0 * DEGREE,
    imu_roll=2.0 * DEGREE,
    shaking=0.0,
    bias_walk=0.0,
)
HARD = Body(wobble=0.0, dive=0.0, camber=0.0)


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def driven(rng, legs, vehicle=QUIET, body=HARD, **options):
    truth = travel(legs, rng, body=body, heading=0.7)
    return simulated_drive(truth, rng, vehicle, **options)


def test_the_velocity_is_the_derivative_of_the_path_along_the_vehicle(rng):
    truth = travel(city(rng, 60.0) + parking(rng), rng)
    velocity = np.gradient(truth.position, truth.period, axis=0)
    ahead = velocity[:, 0] * np.cos(truth.yaw) + velocity[:, 1] * np.sin(truth.yaw)
    assert ahead == pytest.approx(truth.speed, abs=0.1)
    assert truth.speed.min() < -1.0


def test_the_force_is_up_and_the_vehicles_own_acceleration(rng):
    drive = driven(rng, city(rng, 60.0))
    pull = drive.force @ drive.vehicle.imu_pose.T
    level = np.abs(drive.truth.attitude[:, 2, 2] - 1.0) < 1e-9
    pull = pull[level]
    speed, time = drive.truth.speed, drive.time
    spin = np.gradient(drive.truth.yaw, time)
    expected = np.column_stack([np.gradient(speed, time), speed * spin])[level]
    assert pull[:, :2] == pytest.approx(expected, abs=0.05)
    assert pull[:, 2] == pytest.approx(STANDARD_GRAVITY, abs=0.05)


def test_gravity_and_field_give_the_imu_yaw_without_disturbances(rng):
    drive = driven(rng, circles(20.0), streets=None)
    field = drive.correction_at(drive.time[0]).apply(drive.field)
    yaw = yaw_from_up_and_field(drive.up, field)
    assert np.degrees(np.abs(wrap_angle(yaw - drive.imu_yaw))).max() < 0.01
    off = drive.imu_yaw - drive.truth.yaw - drive.vehicle.robot.declination
    assert np.degrees(off) == pytest.approx(20.0, abs=0.1)


def test_the_gyro_integrates_to_the_yaw(rng):
    drive = driven(rng, circles(20.0))
    spin = (drive.rate @ drive.vehicle.imu_pose.T)[:, 2]
    turned = np.sum(spin) * drive.truth.period
    assert turned == pytest.approx(drive.truth.yaw[-1] - drive.truth.yaw[0], abs=0.02)


def test_street_disturbances_have_the_requested_size_and_correlation_length(rng):
    """Over many streets: one has too few places to tell."""
    places = np.column_stack([np.arange(0.0, 60.0, 1.0), np.zeros(60)])
    fields = np.array(
        [StreetField(Streets(waves=40), rng).at(places[[0, 1, 30]]) for _ in range(800)]
    )
    fields = fields.swapaxes(1, 2).reshape(-1, 3) * 1e6
    # The quartile of Student's distribution of four degrees of freedom and size one is 0.524.
    assert np.median(np.abs(fields)) == pytest.approx(3.0 * 0.524, rel=0.1)
    # Signs show the correlation despite heavy tails (Greiner's relation).
    signs = np.sign(fields)
    near, far = (math.sin(0.5 * math.pi * np.mean(signs[:, 0] * signs[:, n])) for n in (1, 2))
    assert near == pytest.approx(0.7 * math.exp(-1.0 / 30.0) + 0.3 * math.exp(-0.5), abs=0.06)
    assert far == pytest.approx(0.7 * math.exp(-1.0), abs=0.08)
    assert np.mean(fields**4) / np.mean(fields**2) ** 2 > 4.0


def test_the_same_place_has_the_same_disturbance(rng):
    truth = travel(one_street(2, back=False), rng, body=HARD)
    field = StreetField(Streets(small_share=0.0), rng)
    bent = field.along(truth.position)
    east = truth.position[:, 0]
    ahead, astern = truth.speed > 7.9, truth.speed < -7.9
    order = np.argsort(east[astern])
    again = np.interp(east[ahead], east[astern][order], bent[astern][order, 0])
    assert again == pytest.approx(bent[ahead, 0], abs=0.3e-6)


def test_fixes_are_late_and_missing_in_an_outage(rng):
    receiver = Receiver(drift=0.0, noise=0.0, delay=0.5, speed_noise=0.1, outages=((20.0, 30.0),))
    drive = driven(rng, [Leg(10.0), Leg(5.0, 10.0), Leg(60.0, 10.0)], receiver=receiver)
    since = np.array([p.stamp for p in drive.positions]) - drive.time[0]
    assert not ((since > 20.0) & (since < 30.0)).any()
    last = drive.positions[-1]
    late = [np.interp(last.stamp - 0.5, drive.time, xs) for xs in drive.truth.position.T]
    assert (last.east, last.north) == pytest.approx(late, abs=1e-6)
    assert np.hypot(drive.velocities[-1].east, drive.velocities[-1].north) == pytest.approx(
        10.0, abs=0.6
    )


def test_faults_of_wheels_are_simulated(rng):
    legs = reversing(rng, 4, share=0.5)

    def stated(**faults):
        wheels = Wheels(noise=0.0, step=0.0, delay=0.0, **faults)
        drive = driven(rng, legs, wheels=wheels)
        speeds = np.array([s.speed for s in drive.speeds])
        stamps = np.array([s.stamp for s in drive.speeds])
        return speeds, np.interp(stamps, drive.time, drive.truth.speed)

    speeds, truth = stated()
    assert speeds == pytest.approx(truth)
    speeds, truth = stated(scale=3.6, is_signed=False)
    assert speeds == pytest.approx(3.6 * np.abs(truth))
    speeds, _ = stated(frozen_from=20.0)
    assert np.ptp(speeds[401:]) == 0.0


def test_iron_has_a_time_and_a_fence_a_place(rng):
    iron = Iron((5e-6, 0.0, 0.0), 10.0, 20.0)
    drive = driven(rng, [Leg(30.0)], streets=None, irons=(iron,))
    strength = [
        drive.correction_at(drive.time[0] + s).apply(
            drive.field[np.searchsorted(drive.time, drive.time[0] + s)]
        )
        for s in (5.0, 15.0, 25.0)
    ]
    assert strength[1] == pytest.approx(strength[0], abs=1e-9)
    assert strength[2] == pytest.approx(strength[0], abs=1e-9)
    assert np.linalg.norm(drive.field[800] - drive.field[100]) > 4e-6
    fence = Fence((0.0, 8e-6, 0.0), heading=0.7)
    drive = driven(rng, one_street(2), streets=None, fences=(fence,))
    bent = np.linalg.norm(drive.disturbance, axis=1)
    out = np.cos(drive.truth.yaw - 0.7) > 0.9
    assert bent[out] == pytest.approx(8e-6)
    assert bent[np.cos(drive.truth.yaw - 0.7) < 0.8].max() == 0.0


def test_a_boat_drifts_sideways(rng):
    truth = travel([Leg(60.0)], rng, current=(0.5, -0.2))
    assert truth.position[-1] == pytest.approx([30.0, -12.0], abs=0.1)


def test_samples_are_complete_and_ordered_by_stamp(rng):
    drive = driven(rng, [Leg(5.0)])
    samples = list(drive.samples())
    stamps = [s.stamp for s in samples]
    assert stamps == sorted(stamps)
    kinds = [type(s) for s in samples]
    assert kinds.count(ImuSample) == kinds.count(FieldSample) == len(drive.time)
    assert kinds.count(SpeedSample) == len(drive.speeds) == 100
    assert dataclasses.replace(drive, positions=()).positions == ()
