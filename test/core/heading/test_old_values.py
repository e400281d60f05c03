"""Yaw by old values of a magnetometer that is frozen, coarse, late or read too often."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fusing import CALIBRATED, Fusing
from long_form import first_of
from moving import ROBOT, Course

from magcal_ros.core import Figure
from magcal_ros.core.geometry import interpolated, wrap_angle
from magcal_ros.core.samples import ImuSample

QUIET = replace(ROBOT, noise_field=0.02e-6)


class Repeating:
    """Passes the samples of a magnetometer on, and repeats its values while it is told to."""

    def __init__(self, step=0.0, each=1, calibration=CALIBRATED):
        self.fusing, self.true_yaws = Fusing(calibration), []
        self.step, self.each, self.count = step, each, 0
        self.is_frozen, self.value = False, None

    def __call__(self, sample, ride):
        if not isinstance(sample, ImuSample):
            sample = sample._replace(field=self.repeated(sample.field))
            self.true_yaws.append(ride.magnetic_yaw)
        self.fusing(sample, ride)

    def repeated(self, field):
        if self.step:
            field = tuple(self.step * round(each / self.step) for each in field)
        self.count += 1
        if self.value is None or not (self.is_frozen or self.count % self.each):
            self.value = field
        return self.value

    @property
    def compass_errors(self):
        yaw = np.array(self.fusing.raw)[:, 1]
        return np.degrees(wrap_angle(yaw - self.true_yaws[-len(yaw) :]))

    @property
    def fused_ratios(self):
        return np.abs(self.fusing.errors_deg() / self.fusing.sigmas_deg())[200:]

    @property
    def compass_ratios(self):
        sigma = np.degrees(np.sqrt(np.array(self.fusing.raw)[:, 2]))
        return np.abs(self.compass_errors / sigma)[50:]


@pytest.mark.parametrize("rate", first_of([0.05, 0.2, 0.5]))
def test_a_frozen_magnetometer_does_not_mislead_the_yaw(rate):
    """Its value looks undisturbed, and would be accepted for lack of a better one."""
    scene = Repeating()
    course = Course(scene, seed=3)
    course.go(5.0)
    course.go(10.0, yaw_rate=0.5)
    scene.is_frozen = True
    course.go(3.0, yaw_rate=rate)
    course.go(83.0)
    course.go(5.0, yaw_rate=rate)
    course.go(5.0)
    assert np.abs(scene.fusing.errors_deg()[200:]).max() < 3.0
    assert scene.fused_ratios.max() < 2.0
    assert scene.compass_ratios.max() < 3.5
    assert scene.fusing.streams.turned_unchanged == pytest.approx(8.0 * rate, rel=0.1)
    scene.is_frozen = False
    course.go(5.0)
    assert scene.fusing.streams.turned_unchanged == 0.0
    assert scene.fused_ratios.max() < 2.0


@pytest.mark.nightly
@pytest.mark.parametrize("step", [3e-6, 0.3e-6])
def test_the_yaw_of_a_coarse_and_quiet_magnetometer(step):
    """Between two values it turns by up to 8°, which must not be taken for the gyro's bias."""
    scene = Repeating(step=step)
    course = Course(scene, QUIET, seed=3)
    for seconds, rate in ((5.0, 0.0), (20.0, 0.05), (60.0, 0.0), (200.0, 0.02), (5.0, 1.0)):
        course.go(seconds, yaw_rate=rate)
    assert np.abs(scene.fusing.errors_deg()[200:]).max() < 0.7 + 1.1e6 * step
    assert scene.fused_ratios.max() < 3.0


def test_values_that_are_published_five_times_have_a_larger_sigma():
    scene = Repeating(each=5)
    course = Course(scene, seed=3)
    course.go(5.0)
    course.go(20.0, yaw_rate=1.0)
    assert scene.compass_ratios.max() < 3.5
    assert scene.fused_ratios.max() < 2.0
    _, _, variance = np.array(scene.fusing.raw).T
    assert math.sqrt(variance.max()) > 3.0 * math.sqrt(variance.min())


class Late(Repeating):
    """Delays the values of the magnetometer, and not their stamps."""

    def __init__(self, seconds, known):
        figures = {**CALIBRATED.evidence.figures, Figure.LATENCY.value: known}
        evidence = replace(CALIBRATED.evidence, figures=figures)
        super().__init__(calibration=replace(CALIBRATED, evidence=evidence))
        self.seconds, self.past = seconds, []

    def __call__(self, sample, ride):
        if not isinstance(sample, ImuSample):
            self.past.append(sample)
            stamps = np.array([each.stamp for each in self.past[-200:]])
            fields = np.array([each.field for each in self.past[-200:]])
            measured = interpolated(np.array([sample.stamp - self.seconds]), stamps, fields)
            sample = sample._replace(field=tuple(measured[0]))
        super().__call__(sample, ride)


def turn_to_both_sides(scene):
    course = Course(scene, seed=3)
    course.go(5.0)
    for rate in (0.5, -1.0, 1.5):
        course.go(6.0, yaw_rate=rate)
        course.go(2.0)
    return scene


@pytest.mark.parametrize("seconds", first_of([0.08, 0.01, 0.3]))
def test_the_latency_that_a_turn_found_is_corrected(seconds):
    exact = turn_to_both_sides(Late(0.0, 0.0))
    scene = turn_to_both_sides(Late(seconds, seconds))
    ignored = turn_to_both_sides(Late(seconds, 0.0))
    usual, late, wrong = (
        np.sqrt(np.mean(each.compass_errors[100:] ** 2)) for each in (exact, scene, ignored)
    )
    assert late < 1.1 * usual
    assert wrong > late
    assert scene.compass_ratios.max() < 3.5
    assert np.abs(scene.fusing.errors_deg()[200:]).max() < 1.0


def test_the_published_field_is_the_measured_one():
    scene = turn_to_both_sides(Late(0.08, 0.08))
    sample = scene.past[1000]
    reading = scene.fusing.reader.read(scene.fusing.compass, sample)
    assert reading.measured == scene.fusing.compass.correct(sample.field)


@pytest.mark.parametrize("sense", [-1.0, 1.0])
def test_the_turn_is_counted_without_rests_and_bias(sense):
    scene = Repeating()
    course = Course(scene, seed=4)
    course.go(5.0)
    before = scene.fusing.follower.turned
    course.go(4.0, yaw_rate=sense * 0.5)
    course.go(60.0)
    assert scene.fusing.follower.turned - before == pytest.approx(sense * 2.0, abs=0.1)


def test_a_field_without_noise_shows_a_large_bias_at_rest():
    """Simulators publish such a field; its repeated values are no sign of a frozen sensor."""
    scene = Repeating()
    robot = replace(ROBOT, noise_field=0.0, gyro_bias=np.array([0.03, -0.03, 0.09]))
    course = Course(scene, robot, seed=3)
    course.go(10.0)
    course.go(4.0, yaw_rate=0.5)
    course.go(20.0)
    assert scene.fused_ratios.max() < 2.0
    assert np.abs(scene.fusing.errors_deg()[-100:]).max() < 1.0


class FrozenGyro(Fusing):
    """Receives a gyro whose rates are rounded to a step, and repeated while it is told to."""

    def __init__(self, step=0.0):
        super().__init__()
        self.step, self.is_frozen, self.rate = step, False, None

    def __call__(self, sample, ride=None):
        if isinstance(sample, ImuSample):
            if self.rate is None or not self.is_frozen:
                self.rate = sample.rate
            if self.step:
                self.rate = tuple(self.step * round(each / self.step) for each in self.rate)
            sample = sample._replace(rate=self.rate)
        super().__call__(sample, ride)


@pytest.mark.parametrize("frozen_at", first_of([0.0, 0.3]))
def test_with_a_frozen_gyro_the_fused_yaw_follows_the_compass(frozen_at):
    """The yaw was up to 180° off, at a predicted error of 4°."""
    fusing = FrozenGyro()
    course = Course(fusing, seed=3)
    course.go(10.0)
    course.go(5.0, yaw_rate=frozen_at)
    fusing.is_frozen = True
    course.go(1.0, yaw_rate=frozen_at)
    since = len(fusing.found)
    for rate in (0.3, 0.0, -0.5, 0.0):
        course.go(5.0, yaw_rate=rate)
    assert fusing.follower.turned_unmeasured > math.radians(60.0)
    fusing.is_frozen = False
    course.go(0.1)
    assert fusing.follower.turned_unmeasured == 0.0
    errors, sigmas = fusing.errors_deg()[since:], fusing.sigmas_deg()[since:]
    assert np.abs(errors).max() < 15.0
    assert np.sqrt(np.mean(errors**2)) < 4.0
    assert np.mean((errors / sigmas) ** 2) < 2.0


def test_a_gyro_that_shows_zeros_at_rest_measures():
    """A step of 1/16 °/s, as of a BNO055: the zeros were taken for an absent gyro."""
    coarse, fine = FrozenGyro(math.radians(1.0 / 16.0)), Fusing()
    robot = replace(ROBOT, gyro_bias=np.zeros(3), noise_rate=math.radians(0.02))
    for fusing in (coarse, fine):
        course = Course(fusing, robot=robot, seed=3)
        course.go(5.0)
        for rate in (0.6, 0.0, -0.3, 0.0):
            course.go(5.0, yaw_rate=rate)
        assert fusing.follower.turned_unmeasured < math.radians(5.0)
    assert len(coarse.found) > 0.99 * len(fine.found)
    assert np.abs(coarse.errors_deg()[1000:]).max() < 0.5
    assert coarse.sigmas_deg()[1000:].max() < 1.2 * fine.sigmas_deg()[1000:].max()
