"""The fused yaw and the truth: smoother than raw, hardly disturbed by iron, and it recovers."""

import dataclasses
import math

import numpy as np
import pytest
from examples import examples
from fusing import CALIBRATED, Fusing
from hypothesis import given
from hypothesis import strategies as st
from long_form import first_of
from moving import FORWARD, ROBOT, Course
from sample_results import EVIDENCE
from simulated import Vehicle, city, simulated_drive, travel

from magcal_ros.core import Calibration, Compass, Correction
from magcal_ros.core.geometry import wrap_angle
from magcal_ros.core.heading import FUSION, PATIENCE, CompassReading, FieldUse, FusedYaw
from magcal_ros.core.samples import ImuSample, SpeedSample
from magcal_ros.core.up import GyroBias, Up
from magcal_ros.files import read_csv_folder

UNBIASED = GyroBias((0.0, 0.0, 0.0), 0.0)
IRON = np.array([0.3 * ROBOT.strength, 0.0, 0.0])
"""Tesla to the east: it turns the compass by 35 degrees."""


def driven(fusing, seed=1):
    course = Course(fusing, seed=seed)
    course.go(3.0)
    return course


@pytest.mark.parametrize("late", [0.0, 0.3])
def test_the_first_yaw_includes_the_turn_since_a_late_field_sample(late):
    fusing, waiting = Fusing(), []

    def deliver(sample, ride):
        if isinstance(sample, ImuSample):
            fusing(sample, ride)
        else:
            waiting.append(sample)
        while waiting and waiting[0].stamp <= ride.stamp - late:
            fusing(waiting.pop(0))

    course = Course(deliver)
    course.go(1.0, yaw_rate=0.8)
    assert abs(fusing.errors_deg()[0]) < 3.0


def test_there_is_no_yaw_before_a_field_sample_and_then_that_of_the_compass():
    fusing = Fusing()
    course = Course(lambda s, r: fusing(s, r) if isinstance(s, ImuSample) else None)
    course.go(1.0)
    assert not fusing.found
    course.listener = fusing
    course.go(1.0)
    assert abs(fusing.errors_deg()[-1]) < 3.0


def test_the_yaw_is_smooth_and_correct_while_driving():
    fusing = Fusing()
    course = driven(fusing)
    for side in (1.0, -1.0):
        course.go(1.0, acceleration=2.0 * FORWARD)
        course.circle(12.0, rate=0.5 * side)
    errors, sigmas = fusing.errors_deg()[200:], fusing.sigmas_deg()[200:]
    assert np.sqrt(np.mean(errors**2)) < 0.8
    assert np.abs(np.diff(errors)).max() < 0.2
    assert np.mean((errors / sigmas) ** 2) < 1.5


def test_a_start_with_an_uncertain_up_is_corrected_by_a_better_compass():
    up, north = (0.0, 0.0, 1.0), CALIBRATED.strength * math.cos(CALIBRATED.inclination)
    down = -CALIBRATED.strength * math.sin(CALIBRATED.inclination)
    fused, compass = FusedYaw(CALIBRATED, PATIENCE), Compass(CALIBRATED)
    for k in range(100):
        yaw, variance = (math.radians(20.0), 0.05) if k < 25 else (0.0, 0.01)
        field = (north * math.sin(yaw), north * math.cos(yaw), down)
        heading = compass.heading(field, up, variance)
        fused.propagate(0.02 * k, Up(up, variance), (0.0, 0.0, 0.0), UNBIASED)
        fused.correct(CompassReading(0.02 * k, field, Up(up, variance), heading, None))
    assert abs(math.degrees(fused.heading().yaw)) < 4.0


def test_passing_iron_hardly_changes_the_yaw_and_is_recorded():
    fusing = Fusing()
    course = driven(fusing)
    course.go(20.0, disturbance=IRON, yaw_rate=0.1)
    raw = fusing.raw[-1][1] - course.ride.magnetic_yaw
    assert abs(math.degrees(float(wrap_angle(raw)))) > 25.0
    assert fusing.fused.detector.use is FieldUse.IGNORED
    assert np.abs(fusing.errors_deg()).max() < 3.0
    assert fusing.sigmas_deg()[-1] > 2.0 * fusing.sigmas_deg()[250]
    course.go(5.0)
    assert fusing.fused.detector.use is FieldUse.GOOD
    assert abs(fusing.errors_deg()[-1]) < 2.0
    assert fusing.fused.detector.last.until - fusing.fused.detector.last.since > 18.0


def test_a_doubtful_field_never_overrules_the_gyro():
    fusing = Fusing()
    course = driven(fusing)
    course.go(10.0, disturbance=np.array([13.5e-6, -2e-6, 0.0]))
    assert fusing.fused.detector.use is FieldUse.WEIGHED_DOWN
    raw = fusing.raw[-1][1] - course.ride.magnetic_yaw
    assert abs(math.degrees(float(wrap_angle(raw)))) > 25.0
    assert np.abs(fusing.errors_deg()).max() < 5.0


def test_iron_that_stays_is_accepted():
    fusing = Fusing(patience=10.0)
    course = driven(fusing)
    course.go(20.0, disturbance=IRON)
    assert fusing.fused.detector.last.is_accepted
    yaw, compass = fusing.found[-1][1], fusing.raw[-1][1]
    assert abs(math.degrees(float(wrap_angle(yaw - compass)))) < 5.0


def test_a_start_beside_iron_recovers_once_the_field_is_good():
    fusing = Fusing()
    course = Course(fusing)
    course.go(5.0, disturbance=IRON)
    assert abs(fusing.errors_deg()[-1]) > 20.0
    assert fusing.sigmas_deg()[-1] > 20.0
    course.go(10.0, yaw_rate=0.2)
    assert abs(fusing.errors_deg()[-1]) < 3.0


def test_a_wrong_yaw_is_corrected_by_a_good_field():
    fusing = Fusing()
    course = driven(fusing)
    course.ride.stand(0.0, 0.0, 2.0)
    course.go(12.0)
    assert abs(fusing.errors_deg()[-1]) < 3.0


def test_after_a_gap_the_compass_gives_a_new_north():
    fusing = Fusing()
    course = driven(fusing)
    course.ride.stamp += 2.0
    course.ride.stand(0.0, 0.0, 2.0)
    course.go(2.0)
    assert np.abs(fusing.errors_deg()[-150:]).max() < 6.0


@pytest.mark.nightly
def test_in_streets_the_yaw_is_better_than_the_compass_with_a_correct_sigma():
    """Streets disturb the field by 3 µT per axis over 30 m: the compass errs by 9 degrees."""
    squares, raws, nees = [], [], []
    for seed in range(1, 7):
        rng = np.random.default_rng(seed)
        truth = travel(city(rng, 180.0), rng)
        drive = simulated_drive(truth, rng, Vehicle(ROBOT), receiver=None)
        fusing = Fusing()
        for sample in drive.samples():
            if isinstance(sample, SpeedSample):
                fusing.estimator.add_travel(sample)
            else:
                fusing(sample)
        stamps, yaws, _ = np.array(fusing.found).T
        errors = np.degrees(wrap_angle(yaws - np.interp(stamps, drive.time, drive.imu_yaw)))
        squares.append(np.mean(errors**2))
        nees.append(np.mean((errors / fusing.sigmas_deg()) ** 2))
        stamps, yaws, _ = np.array(fusing.raw).T
        truth = np.interp(stamps, drive.time, drive.imu_yaw)
        raws.append(np.mean(np.degrees(wrap_angle(yaws - truth)) ** 2))
    print(f"streets: fused {np.sqrt(squares)}, compass {np.sqrt(raws)} deg RMS, NEES {nees}")
    # The median: a drive that begins at steel keeps its first yaw for long.
    assert np.sqrt(np.median(squares)) < 0.7 * np.sqrt(np.median(raws))
    assert 0.1 < np.median(nees) < 2.0


@pytest.mark.nightly
def test_on_a_city_drive_the_sigma_is_correct(recording):
    """Truth is the course of a GPS: one offset is removed, and it is late by 0.6 s."""
    folder = recording("car_drive_neu2022_rahul")
    calibration = Calibration(
        Correction(np.eye(3), np.array([-9.0e-6, -31.9e-6, -5.4e-6])),
        np.zeros((12, 12)),
        0.5e-6,
        0.01,
        51.3e-6,
        math.radians(66.3),
        EVIDENCE,
    )
    fusing = Fusing(calibration)
    for sample in read_csv_folder(folder).samples():
        fusing(sample)
    truth = np.genfromtxt(folder / "truth.csv", delimiter=",", skip_header=1)
    found = np.array(fusing.found)
    moments = truth[:, 0] - 0.6
    chosen = (truth[:, 2] > 2.0) & (moments > found[0, 0]) & (moments < found[-1, 0])
    gap = np.interp(moments[chosen], found[:, 0], np.unwrap(found[:, 1])) - truth[chosen, 1]
    gap = wrap_angle(gap - np.angle(np.mean(np.exp(1j * gap))))
    nees = np.mean(gap**2 / np.interp(moments[chosen], found[:, 0], found[:, 2]))
    print(f"city: {np.degrees(np.sqrt(np.mean(gap**2))):.2f} deg RMS, NEES {nees:.2f}")
    assert np.degrees(np.sqrt(np.mean(gap**2))) < 8.0
    assert 0.3 < nees < 2.5


def test_at_rest_in_a_clean_field_the_sigma_is_small():
    fusing = Fusing()
    driven(fusing).go(30.0)
    assert fusing.sigmas_deg()[-1] < 1.5
    assert abs(fusing.errors_deg()[-1]) < 2.0 * fusing.sigmas_deg()[-1]


@pytest.mark.nightly
def test_a_large_bias_at_rest_does_not_turn_the_yaw():
    plain, biased = Fusing(), Fusing()
    for fusing, bias in ((plain, 0.0), (biased, 5.0)):
        robot = dataclasses.replace(ROBOT, gyro_bias=np.radians([bias, -bias, bias]))
        course = Course(fusing, robot)
        course.go(10.0)
        course.circle(20.0)
    late = slice(1000, None)
    rms = [np.sqrt(np.mean(fusing.errors_deg()[late] ** 2)) for fusing in (plain, biased)]
    assert rms[1] < rms[0] + 0.2
    assert np.mean((biased.errors_deg() / biased.sigmas_deg()) ** 2) < 1.5


@examples(3)
@given(st.integers(0, 10_000))
def test_missing_late_repeated_and_reordered_messages(seed):
    rng = np.random.default_rng(seed)
    fusing, late = Fusing(), []

    def mangle(sample, ride):
        chance = rng.random()
        if chance < 0.05:
            return
        if chance < 0.1:
            late.append(sample)
            return
        fusing(sample, ride)
        if chance > 0.95:
            fusing(sample, ride)
        if late and chance > 0.8:
            fusing(late.pop(), ride)

    course = Course(mangle, seed=seed)
    course.go(3.0)
    course.circle(8.0)
    found = np.array(fusing.found)
    assert np.isfinite(found).all()
    assert (found[:, 2] > 0.0).all()
    ratio = fusing.errors_deg()[100:] / fusing.sigmas_deg()[100:]
    assert np.mean(ratio**2) < 3.0


@pytest.mark.nightly
def test_the_fused_yaw_is_better_on_a_hand_held_recording(recording):
    folder = recording("broad05")
    bias = np.array([-0.14e-6, 0.20e-6, 0.39e-6])
    calibration = Calibration(
        Correction(np.eye(3), bias),
        np.zeros((12, 12)),
        0.4e-6,
        0.01,
        44.3e-6,
        math.radians(69.6),
        EVIDENCE,
    )
    fusing = Fusing(calibration)
    for sample in read_csv_folder(folder).samples():
        fusing(sample._replace(stamp=sample.stamp + 1.0))
    truth = np.genfromtxt(folder / "truth.csv", delimiter=",", skip_header=1)
    x, y = truth[:, 3], truth[:, 4]
    tilt = np.arccos(np.clip(1 - 2 * (x * x + y * y), -1, 1))

    def rms(rows):
        rows = np.array(rows)
        stamps = rows[:, 0] - 1.0
        gap = wrap_angle(rows[:, 1] - np.interp(stamps, truth[:, 0], np.unwrap(truth[:, 1])))
        level = np.interp(stamps, truth[:, 0], tilt) < math.radians(45.0)
        return math.degrees(math.sqrt(np.mean(gap[level] ** 2)))

    raw, fused = rms(fusing.raw), rms(fusing.found)
    print(f"broad05, tilt below 45 deg: raw {raw:.2f}, fused {fused:.2f} deg RMS")
    assert fused < 0.55 * raw
    assert fused < 1.6


@pytest.mark.parametrize("rate", first_of([10.0, 400.0]))
def test_slow_and_fast_imus(rate):
    fusing = Fusing()
    course = Course(fusing, rate=rate)
    course.go(3.0)
    course.go(3.0, yaw_rate=0.5)
    assert abs(fusing.errors_deg()[-1]) < 3.0


def test_an_external_heading_corrects_the_yaw_and_determines_the_bias():
    fused = FusedYaw(CALIBRATED, PATIENCE)
    up, field = Up((0.0, 0.0, 1.0), 1e-4), CALIBRATED.strength * np.array([0.0, 0.4, -0.9])
    heading = Compass(CALIBRATED).heading(tuple(field), (0.0, 0.0, 1.0), 1e-4)
    reported, unknown = [0.0, 0.0], GyroBias((0.0, 0.0, 0.0), math.radians(0.5) ** 2)
    for k in range(3000):
        stamp = 100.0 + 0.02 * k
        # An unknown gyro bias of 0.3 °/s, while the robot stands.
        fused.propagate(stamp, up, (0.0, 0.0, math.radians(0.3)), unknown)
        if k == 0:
            fused.correct(CompassReading(stamp, tuple(field), up, heading, None))
        elif k % 10 == 0 and k < 2500:
            missed = fused.take_heading(stamp, heading.yaw, math.radians(1.0) ** 2, (1.0, 0.0, 0.0))
            assert missed < FUSION.heading_gate
        if k in (2500, 2999):
            reported[k == 2999] = abs(fused.heading().yaw - heading.yaw)
    assert reported[0] < math.radians(1.0)
    # Ten seconds of silence would be 3° with the bias as it was.
    assert reported[1] < math.radians(2.0)
    assert fused.take_heading(200.0, heading.yaw + 1.0, 1e-4, (1.0, 0.0, 0.0)) is None
    last = 100.0 + 0.02 * 3000
    fused.propagate(last, up, (0.0, 0.0, 0.0), UNBIASED)
    before = fused.heading().yaw
    assert fused.take_heading(last, before + 1.0, 1e-4, (1.0, 0.0, 0.0)) > FUSION.heading_gate
    assert fused.heading().yaw == before


def test_a_rest_shows_the_gyro_bias():
    fused, up, rate = FusedYaw(CALIBRATED, PATIENCE), Up((0.0, 0.0, 1.0), 1e-6), (0.0, 0.0, 5e-4)
    field = tuple(CALIBRATED.strength * np.array([0.0, 0.4, -0.9]))
    heading = Compass(CALIBRATED).heading(field, up.direction, up.variance)
    going, resting = (GyroBias((0.0, 0.0, 0.0), 1e-4, shown) for shown in (None, (rate, 1e-6)))
    fused.propagate(99.98, up, rate, GyroBias((0.0, 0.0, 0.0), 1e-6))
    fused.correct(CompassReading(99.98, field, up, heading, None))
    for k in range(3000):
        # A robot that goes straight on but for the second third of a minute.
        known = resting._replace() if 1000 <= k < 2000 else going
        fused.propagate(100.0 + 0.02 * k, up, rate, known)
    # A minute with this bias is 1.7°.
    assert abs(fused.heading().yaw - heading.yaw) < math.radians(0.2)


@pytest.mark.nightly
@pytest.mark.parametrize("walk", first_of([3e-4, 0.0]))
def test_external_headings_show_whether_gyro_or_compass_is_better(walk):
    rng = np.random.default_rng(3)
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = (1e-6) ** 2 * np.eye(3)
    poor = dataclasses.replace(CALIBRATED, covariance=covariance)
    fused, up, bias = FusedYaw(poor, PATIENCE), Up((0.0, 0.0, 1.0), 1e-6), 0.003
    # North is ahead, and the compass is off by a sigma of its calibration.
    field = tuple(poor.strength * np.array([0.4, 0.0, -0.9]) + [0.0, 1e-6, 0.0])
    heading = Compass(poor).heading(field, up.direction, up.variance)
    for k in range(16000):
        stamp = 100.0 + 0.02 * k
        bias += walk * math.sqrt(0.02) * rng.standard_normal()
        rate = (0.0, 0.0, bias + 2e-3 * rng.standard_normal())
        fused.propagate(stamp, up, rate, UNBIASED)
        if k % 5 == 0:
            fused.correct(CompassReading(stamp, field, up, heading, None))
        if k % 10 == 5 and k < 13000:
            yaw = 0.5 * math.pi + math.radians(0.5) * rng.standard_normal()
            fused.take_heading(stamp, yaw, math.radians(1.0) ** 2, (1.0, 0.0, 0.0))
    compass, now = heading.yaw - 0.5 * math.pi, fused.heading()
    off, sigma = now.yaw - 0.5 * math.pi, math.sqrt(now.yaw_variance)
    assert abs(off) < min(2.0 * sigma, 0.6 * abs(compass))
    assert sigma < math.sqrt(heading.yaw_variance)


def test_headings_that_drift_before_they_stop_enlarge_the_variance():
    """A random walk of the gyro bias looks the same: the yaw erred by 8.6° at ±2.9°."""
    rng = np.random.default_rng(11)
    fused, up = FusedYaw(CALIBRATED, PATIENCE), Up((0.0, 0.0, 1.0), 1e-6)
    field = tuple(CALIBRATED.strength * np.array([0.4, 0.0, -0.9]))
    compass = Compass(CALIBRATED).heading(field, up.direction, up.variance)
    known = GyroBias((0.0, 0.0, 0.0), 1e-4)
    off, sigma = [], []
    for k in range(9000):
        since = 0.02 * k
        rate = (0.0, 0.0, 0.003 + 2e-3 * rng.standard_normal())
        fused.propagate(100.0 + since, up, rate, known)
        if k == 0:
            fused.correct(CompassReading(100.0, field, up, compass, None))
        if k % 10 == 5 and since < 120.0:
            drift = math.radians(0.3) * max(0.0, since - 60.0)
            reported = 0.5 * math.pi + drift + math.radians(1.0) * rng.standard_normal()
            fused.take_heading(100.0 + since, reported, math.radians(1.0) ** 2, (1.0, 0.0, 0.0))
        if since >= 100.0:
            off.append(fused.heading().yaw - 0.5 * math.pi)
            sigma.append(math.sqrt(fused.heading().yaw_variance))
    assert (np.abs(off) < 3.0 * np.array(sigma)).all()


@pytest.mark.nightly
def test_headings_by_an_integrated_gyro_that_rests_contradict_enlarge_the_variance():
    """They drift evenly, like a constant gyro bias: the error was 24° at a sigma of 1°."""
    rng = np.random.default_rng(92_000)
    fused, up = FusedYaw(CALIBRATED, PATIENCE), Up((0.0, 0.0, 1.0), 1e-6)
    field = tuple(CALIBRATED.strength * np.array([0.4, 0.0, -0.9]))
    compass = Compass(CALIBRATED).heading(field, up.direction, up.variance)
    known = GyroBias((0.0, 0.0, 0.0), 1e-4)
    for k in range(12_000):
        since = 0.02 * k
        rate = (0.0, 0.0, 0.003 + 2e-3 * rng.standard_normal())
        if since > 20.0 and since % 40.0 < 0.01:
            shown = (0.0, 0.0, 0.003 + 2e-4 * rng.standard_normal())
            known = GyroBias((0.0, 0.0, 0.0), 1e-4, (shown, 2e-4**2))
        elif known.at_rest is not None:
            known = GyroBias((0.0, 0.0, 0.0), 1e-4)
        fused.propagate(100.0 + since, up, rate, known)
        if k == 0:
            fused.correct(CompassReading(100.0, field, up, compass, None))
        if k % 10 == 5:
            reported = 0.5 * math.pi + math.radians(0.1) * since
            reported += math.radians(1.0) * rng.standard_normal()
            fused.take_heading(100.0 + since, reported, math.radians(1.0) ** 2, (1.0, 0.0, 0.0))
    off = fused.heading().yaw - 0.5 * math.pi
    assert abs(off) < 3.0 * math.sqrt(fused.heading().yaw_variance)


LEVEL = ROBOT.strength * math.cos(ROBOT.inclination)


def magnet_that_turns_the_field(yaw, angle):
    """Return iron, as the sensor reads it, that turns the level field at a yaw, no more."""
    north = np.array([math.sin(yaw), math.cos(yaw), 0.0])
    turned = np.array([math.sin(yaw - angle), math.cos(yaw - angle), 0.0])
    return np.linalg.solve(ROBOT.true_correction.matrix, LEVEL * (turned - north))


class Magnetised(Fusing):
    """A robot to which a magnet can be added."""

    magnet = np.zeros(3)

    def __call__(self, sample, ride=None):
        if not isinstance(sample, ImuSample):
            sample = sample._replace(field=tuple(np.add(sample.field, self.magnet).tolist()))
        super().__call__(sample, ride)


@pytest.mark.parametrize("angle", first_of([1.2, -0.8]))
def test_an_added_magnet_is_in_the_sigma_until_the_robot_turns(angle):
    fusing = Magnetised()
    course = driven(fusing)
    fusing.magnet = magnet_that_turns_the_field(course.ride.magnetic_yaw, angle)
    course.go(12.0)
    error, sigma = abs(fusing.errors_deg()[-1]), fusing.sigmas_deg()[-1]
    assert error > 0.8 * abs(math.degrees(angle))
    assert sigma > 0.6 * error
    assert fusing.fused.is_ambiguous
    assert "the next turn of the robot shows which" in fusing.fused.field_jump.in_words
    fusing.magnet = np.zeros(3)
    course.go(15.0)
    assert abs(fusing.errors_deg()[-1]) < 3.0
    assert fusing.sigmas_deg()[-1] < 0.5 * sigma


def test_a_wrong_yaw_is_certain_again_after_a_turn():
    fusing = Fusing()
    course = driven(fusing)
    course.ride.stand(0.0, 0.0, 2.0)
    course.go(12.0)
    assert fusing.sigmas_deg()[-1] > 20.0
    course.go(40.0, yaw_rate=0.2)
    assert abs(fusing.errors_deg()[-1]) < 3.0
    assert fusing.sigmas_deg()[-1] < 6.0
