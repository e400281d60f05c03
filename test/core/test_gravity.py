"""Up stays up on a car's circle, and follows a robot that is set down elsewhere."""

import math

import numpy as np
import pytest

from magcal_ros.core.gravity import CarriedGravity
from magcal_ros.core.streams import ImuSample

G = 9.81


def drive(gravity, seconds, rate=0.4, pull=0.1, tilt=0.0, start=1.0):
    """A steady circle with a pull to the outside, the body leaned by `tilt` about x."""
    for k in range(int(seconds * 100)):
        up = np.array([0.0, math.sin(tilt), math.cos(tilt)])
        force = G * (up + np.array([0.0, pull, 0.0]))
        gravity.add(ImuSample(start + 0.01 * k, tuple(force), tuple(rate * up)))
    return np.degrees(math.acos(min(1.0, float(np.dot(gravity.up, up)))))


def test_at_rest_it_is_the_accelerometer():
    gravity = CarriedGravity()
    assert drive(gravity, 2.0, rate=0.0, pull=0.0, tilt=0.2) < 0.01


def test_a_robot_set_down_elsewhere_is_followed_within_a_second():
    gravity = CarriedGravity()
    drive(gravity, 2.0, rate=0.0, pull=0.0)
    assert drive(gravity, 1.0, rate=0.0, pull=0.0, tilt=0.15, start=3.0) < 0.1


def test_a_pull_on_a_circle_moves_it_far_less_than_the_accelerometer():
    gravity = CarriedGravity()
    drive(gravity, 2.0, rate=0.0, pull=0.0)
    leaned = drive(gravity, 5.0, start=3.0)
    accelerometer = math.degrees(math.atan(0.1))
    assert leaned < 0.55 * accelerometer


def test_a_turning_robot_on_a_slope_keeps_its_up():
    rate, tilt, gravity = 0.5, math.radians(10.0), CarriedGravity()
    for k in range(1300):
        angle = rate * 0.01 * k
        up = np.array(
            [math.sin(tilt) * math.cos(angle), -math.sin(tilt) * math.sin(angle), math.cos(tilt)]
        )
        gravity.add(ImuSample(1.0 + 0.01 * k, tuple(G * up), (0.0, 0.0, rate)))
        assert float(np.dot(gravity.up, up)) > math.cos(math.radians(0.1))


@pytest.mark.parametrize("gap", [0.6, -1.0])
def test_a_gap_or_a_step_back_starts_anew(gap):
    gravity = CarriedGravity()
    drive(gravity, 1.0)
    gravity.add(ImuSample(2.0 + gap, (G, 0.0, 0.0), (0.0, 0.0, 0.4)))
    assert gravity.up == (1.0, 0.0, 0.0)


def test_without_a_gyro_there_is_none():
    gravity = CarriedGravity()
    gravity.add(ImuSample(1.0, (0.0, 0.0, G), (math.nan,) * 3))
    assert gravity.up is None
