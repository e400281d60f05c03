"""Yaw by a magnetometer that repeats old values: it is frozen, coarse or read too often."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fusing import Fusing
from moving import ROBOT, Course

from magcal_ros.core.geometry import wrap_angle
from magcal_ros.core.samples import ImuSample

QUIET = replace(ROBOT, noise_field=0.02e-6)


class Repeating:
    """Passes the samples of a magnetometer on, and repeats its values while it is told to."""

    def __init__(self, step=0.0, each=1):
        self.fusing, self.true_yaws = Fusing(), []
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
    def fused_ratios(self):
        return np.abs(self.fusing.errors_deg() / self.fusing.sigmas_deg())[200:]

    @property
    def compass_ratios(self):
        _, yaw, variance = np.array(self.fusing.raw).T
        return np.abs(wrap_angle(yaw - self.true_yaws[-len(yaw) :]) / np.sqrt(variance))[50:]


@pytest.mark.parametrize("rate", [0.05, 0.2, 0.5])
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


@pytest.mark.parametrize(("step", "largest"), [(0.3e-6, 1.0), (3e-6, 4.0)])
def test_the_yaw_of_a_coarse_and_quiet_magnetometer(step, largest):
    """Between two values it turns by up to 8°, which must not be taken for the gyro's bias."""
    scene = Repeating(step=step)
    course = Course(scene, QUIET, seed=3)
    for seconds, rate in ((5.0, 0.0), (20.0, 0.05), (60.0, 0.0), (200.0, 0.02), (5.0, 1.0)):
        course.go(seconds, yaw_rate=rate)
    assert np.abs(scene.fusing.errors_deg()[200:]).max() < largest
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


@pytest.mark.parametrize("sense", [-1.0, 1.0])
def test_the_turn_is_counted_without_rests_and_bias(sense):
    scene = Repeating()
    course = Course(scene, seed=4)
    course.go(5.0)
    before = scene.fusing.follower.turned
    course.go(4.0, yaw_rate=sense * 0.5)
    course.go(60.0)
    assert scene.fusing.follower.turned - before == pytest.approx(sense * 2.0, abs=0.1)
