"""One heading from several magnetometers, while one is silent, frozen or disturbed."""

import dataclasses
import math

import numpy as np
import pytest
from long_form import first_of
from sample_results import EVIDENCE

from magcal_ros.core import Calibration, Compass, Correction
from magcal_ros.core.geometry import wrapped
from magcal_ros.core.heading import PATIENCE, CompassReader, FusedYaw, SeveralCompasses
from magcal_ros.core.samples import FieldSample, ImuSample
from magcal_ros.core.simulation import Ride, Robot
from magcal_ros.core.up import UpFollower

ROBOT = Robot(noise_field=0.1e-6, noise_force=0.05)
ROBOTS = {
    1: ROBOT,
    2: dataclasses.replace(ROBOT, roll=-0.03, hard_iron=np.array([-10e-6, 30e-6, 5e-6])),
    3: dataclasses.replace(ROBOT, pitch=0.06, hard_iron=np.array([5e-6, 5e-6, -30e-6])),
}
LEVEL = ROBOT.strength * math.cos(ROBOT.inclination)


def calibration(robot, sigma=0.3e-6, off=(0.0, 0.0, 0.0), yaw=0.0):
    """A calibration that is off by so much hard iron (tesla) and yaw (radians)."""
    truth = dataclasses.replace(robot, yaw=-yaw).true_correction
    covariance = np.diag([0.0] * 9 + [sigma**2] * 3)
    correction = Correction(truth.matrix, truth.hard_iron + np.array(off))
    reported = (robot.noise_field, 0.005, robot.strength, robot.inclination, EVIDENCE)
    return Calibration(correction, covariance, *reported)


class Scene:
    """A robot with magnetometers whose messages are processed as in the node."""

    def __init__(self, calibrations, gyro=True):
        self.ride = Ride(ROBOT, np.random.default_rng(1), start=100.0, gyro=gyro)
        self.rng = np.random.default_rng(2)
        self.several, self.up = SeveralCompasses(), UpFollower()
        self.compasses = {k: Compass(each) for k, each in calibrations.items()}
        for number, each in calibrations.items():
            self.several.put_in_force(number, each)
        self.fused = FusedYaw(calibrations[1], PATIENCE) if gyro else None
        self.rows = []
        self.silent, self.frozen, self.iron, self.late = set(), {}, {}, {}
        # A rest shows the gyro's bias, and how far off up is.
        self.run(4.0)
        self.rows.clear()

    def run(self, seconds, yaw_rate=0.0):
        """Go on; returns the new rows of stamp, error and sigma."""
        started, until = len(self.rows), self.ride.stamp + seconds
        while self.ride.stamp < until:
            for sample in self.ride.step(yaw_rate):
                if isinstance(sample, ImuSample):
                    self.on_imu(sample)
                else:
                    self.on_field(sample)
        return np.array(self.rows[started:])

    def on_imu(self, sample):
        self.imu = sample
        self.up.add(sample)
        if self.fused is not None:
            self.fused.propagate_by(sample.stamp, self.up)

    def on_field(self, sample):
        body = np.linalg.solve(ROBOT.distortion, np.array(sample.field) - ROBOT.hard_iron)
        for number in self.compasses:
            if number in self.silent:
                continue
            robot = ROBOTS[number]
            raw = robot.raw_field(body + self.iron.get(number, 0.0))
            raw = raw + robot.noise_field * self.rng.standard_normal(3)
            raw = self.frozen.setdefault(number, raw) if number in self.frozen else raw
            stamp = sample.stamp + self.late.get(number, 0.0)
            self.take(number, FieldSample(stamp, tuple(raw)))

    def take(self, number, sample):
        moment = CompassReader(self.up).read(self.compasses[number], sample)
        joined = self.several.add(number, moment, self.imu.stamp, self.fused)
        if joined is not None and joined.heading is not None:
            if self.fused is not None:
                self.fused.correct(joined)
            heading = joined.heading
            off = wrapped(heading.yaw - self.ride.magnetic_yaw)
            self.rows.append((joined.stamp, off, math.sqrt(heading.yaw_variance)))

    @property
    def weights(self):
        return {number: share.weight for number, share in self.several.weights.items()}

    def why(self, number):
        return self.several.weights[number].why


def freeze(scene, number):
    body = np.linalg.solve(ROBOT.distortion, np.zeros(3))
    scene.frozen[number] = ROBOTS[number].raw_field(scene.ride.attitude @ ROBOT.field_enu + body)


def two(**second):
    return Scene({1: calibration(ROBOTS[1]), 2: calibration(ROBOTS[2], **second)})


def test_the_better_one_has_more_weight_and_both_are_better_than_one():
    scene = two(sigma=0.6e-6)
    rows = scene.run(5.0, 0.3)
    assert scene.weights[1] == pytest.approx(0.75, abs=0.05)
    assert np.diff(rows[:, 0]).max() < 0.03
    alone = Scene({1: calibration(ROBOTS[1])}).run(5.0, 0.3)
    assert rows[-1, 2] < alone[-1, 2]
    assert np.mean((rows[50:, 1] / rows[50:, 2]) ** 2) < 1.5


def test_a_frozen_magnetometer_gives_no_heading_while_the_other_is_silent():
    scene = two()
    freeze(scene, 1)
    scene.run(2.0, 0.5)
    assert scene.why(1) == "it repeats the same values"
    scene.silent.add(2)
    scene.run(0.6, 0.5)
    assert len(scene.run(5.0, 0.5)) == 0
    assert scene.why(1) == "it repeats the same values"
    assert scene.why(2) == "it is silent"
    scene.silent.clear()
    rows = scene.run(2.0, 0.5)
    assert len(rows) > 20
    assert np.abs(rows[:, 1] / rows[:, 2]).max() < 3.5


def test_a_single_magnetometer_gives_its_own_heading():
    scene = Scene({1: calibration(ROBOTS[1])})
    compass = Compass(calibration(ROBOTS[1]))
    scene.run(1.0)
    sample = FieldSample(scene.imu.stamp, (2e-5, 1e-5, 3e-5))
    moment = CompassReader(scene.up).read(compass, sample)
    joined = scene.several.add(1, moment, scene.imu.stamp, scene.fused)
    assert np.allclose(joined.field, moment.field, atol=1e-12)
    assert joined.heading.yaw_variance == pytest.approx(moment.heading.yaw_variance)


@pytest.mark.parametrize("number", first_of([1, 2]))
@pytest.mark.parametrize("way", first_of(["dead", "frozen"]))
def test_the_heading_has_no_step_when_one_fails(number, way):
    scene = two()
    before = scene.run(10.0, 0.4)
    if way == "dead":
        scene.silent.add(number)
    else:
        scene.frozen[number] = None
        freeze(scene, number)
    after = scene.run(1.0, 0.4)
    assert scene.weights[number] == 0.0
    assert scene.why(number)
    rows = np.concatenate([before[-1:], after])
    assert np.diff(rows[:, 0]).max() < 0.6
    assert (np.abs(np.diff(rows[:, 1])) < 3.0 * rows[1:, 2]).all()
    assert np.abs(scene.run(5.0, 0.4)[:, 1]).max() < math.radians(4.0)


@pytest.mark.parametrize("iron", first_of([(0.0, 12e-6, 0.0), (0.0, 0.0, 20e-6)]))
def test_a_disturbed_magnetometer_is_left_out_within_a_second_and_reported(iron):
    scene = two()
    scene.run(10.0, 0.3)
    scene.iron[1] = np.array(iron)
    rows = scene.run(1.0, 0.3)
    assert scene.weights[1] < 0.1
    assert scene.why(1)
    rows = np.concatenate([rows[-5:], scene.run(15.0, 0.3)])
    assert np.abs(rows[:, 1]).max() < math.radians(4.0)
    scene.iron.clear()
    scene.run(3.0, 0.3)
    assert not scene.several.disagreement


@pytest.mark.nightly
def test_the_remaining_one_continues_at_the_common_heading():
    scene = two(sigma=1.0e-6, off=(1.0e-6, 1.0e-6, 0.0))
    rows = scene.run(20.0, 0.3)
    scene.iron[1] = np.array([0.0, 15e-6, 0.0])
    later = scene.run(20.0, 0.3)
    rms = [math.sqrt(np.mean(each[50:, 1] ** 2)) for each in (rows, later)]
    assert rms[1] < 1.1 * rms[0] + math.radians(0.2)


@pytest.mark.nightly
def test_iron_near_one_does_not_enlarge_the_variance_of_the_other():
    scene = two(sigma=0.6e-6)
    scene.run(10.0, 0.3)
    scene.iron[1] = np.array([0.0, 15e-6, 0.0])
    rows = scene.run(40.0, 0.3)[25:]
    alone = Scene({1: calibration(ROBOTS[1], sigma=0.6e-6)}).run(5.0, 0.3)
    # The iron turns with the robot: to each side of the field, along it and against it.
    assert rows[:, 2].max() < 1.5 * alone[-1, 2]
    assert np.abs(rows[:, 1]).max() < math.radians(3.0)
    assert scene.weights[1] < 0.1
    assert not scene.several.disagreement


@pytest.mark.nightly
def test_two_that_agree_against_the_gyro_are_trusted():
    """The propagated yaw may be the wrong one."""
    scene = two()
    before = scene.run(10.0, 0.3)
    for number in (1, 2):
        turned = calibration(ROBOTS[number], yaw=math.radians(8.0))
        scene.compasses[number] = Compass(turned)
    rows = scene.run(3.0, 0.3)
    assert rows[-1, 2] < 1.2 * before[-1, 2]


def test_a_constant_disagreement_is_reported_and_in_the_sigma():
    scene = two(yaw=math.radians(20.0))
    rows = scene.run(10.0, 0.3)
    assert math.degrees(scene.several.disagreement) == pytest.approx(20.0, abs=3.0)
    assert math.degrees(rows[-1, 2]) > 7.0
    scene.silent.add(2)
    rows = scene.run(3.0, 0.3)
    assert math.degrees(rows[-1, 2]) > 10.0


@pytest.mark.nightly
def test_a_constant_disagreement_stays_in_a_disturbed_field():
    scene = two(yaw=math.radians(20.0))
    scene.run(5.0, 0.3)
    # So far, and for so long, that the variances of both explain their difference.
    scene.iron = dict.fromkeys((1, 2), np.array([0.0, 0.0, 12e-6]))
    bent = scene.run(10.0, 0.3)
    scene.iron.clear()
    rows = np.concatenate([bent, scene.run(20.0, 0.3)])
    assert (np.abs(rows[:, 1]) < 3.0 * rows[:, 2]).all()
    fused = scene.fused.heading()
    off = abs(wrapped(fused.yaw - scene.ride.magnetic_yaw))
    assert off < 3.0 * math.sqrt(fused.yaw_variance)


@pytest.mark.nightly
def test_one_that_was_turned_while_silent_gets_no_weight():
    scene = two()
    scene.run(5.0, 0.3)
    scene.silent.add(2)
    scene.run(5.0, 0.3)
    scene.compasses[2] = Compass(calibration(ROBOTS[2], yaw=math.radians(25.0)))
    scene.silent.clear()
    rows = scene.run(10.0, 0.3)
    assert scene.weights[2] < 0.005
    assert "its yaw differs" in scene.why(2)
    assert np.abs(rows[:, 1]).max() < math.radians(3.0)


def test_of_three_without_a_gyro_two_outvote_one():
    scene = Scene({k: calibration(robot) for k, robot in ROBOTS.items()}, gyro=False)
    scene.run(3.0)
    scene.iron[3] = np.array([0.0, 12e-6, 0.0])
    scene.run(1.0)
    assert scene.weights[3] < 0.1
    assert scene.weights[1] + scene.weights[2] > 0.9


def test_a_magnetometer_with_another_clock_is_left_out():
    scene = two()
    scene.late[2] = -0.8
    rows = scene.run(3.0, 0.3)
    assert len(rows) == pytest.approx(150, abs=2)
    assert scene.weights[2] == 0.0
    assert "stamps" in scene.why(2)


def test_at_rest_coarse_sensors_both_count():
    scene = two()
    scene.run(1.0)
    for number in (1, 2):
        freeze(scene, number)
    scene.run(3.0)
    assert min(scene.weights.values()) > 0.3


def test_time_that_is_set_back_restarts_the_joining():
    scene = two()
    scene.run(3.0)
    scene.ride.stamp -= 50.0
    scene.up = UpFollower()
    rows = scene.run(2.0)
    assert len(rows) > 90
    assert min(scene.weights.values()) > 0.3
