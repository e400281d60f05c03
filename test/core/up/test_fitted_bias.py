"""The gyro's bias by the fit of a calibration, for up in a circle without a rest."""

import dataclasses
import math

import numpy as np
from circles import circles, known

from magcal_ros.core.calibration import FittedGyroBias
from magcal_ros.core.methods.smoother import fit
from magcal_ros.core.samples import ImuSample
from magcal_ros.core.up import UpFollower

BIAS = (2.0, -1.5, 1.0)  # °/s


def lean_after(follower, window, later=0.0):
    """Follow the samples of a level window; return the lean of up at its end, degrees."""
    rows = zip(window.time + later, window.specific_force, window.angular_rate, strict=True)
    for stamp, force, rate in rows:
        follower.add(ImuSample(stamp, tuple(force), tuple(rate)))
    x, y, z = follower.newest
    return math.degrees(math.atan2(math.hypot(x, y), z))


def test_a_fit_finds_the_bias_that_tilts_up_in_a_circle():
    """The accelerometer cannot separate the tilt from the centripetal acceleration."""
    robot, window = circles(BIAS, radius=2.0, unevenness=0.05)
    window = window.take(window.time < 25.0)
    follower = UpFollower()
    assert lean_after(follower, window) > 6.0
    found = fit(window, known(robot)).gyro
    off = found.rate - robot.gyro_bias
    assert off @ np.linalg.solve(found.covariance, off) < 16.0
    follower.take_bias(found)
    later = window.time[-1] + 0.05
    assert lean_after(follower, window.take(window.time < 0.2), later) < 2.0
    assert lean_after(follower, window.take(window.time >= 0.2), later) < 2.0


def test_a_bias_that_a_rest_has_shown_is_kept():
    follower = UpFollower()
    rng = np.random.default_rng(1)
    for stamp in np.arange(0.0, 10.0, 0.02):
        rate = rng.normal(0.0, 0.001, 3)
        follower.add(ImuSample(stamp, (0.0, 0.0, 9.81), tuple(rate)))
    bias, up = follower.gyro_bias.rate, follower.newest
    follower.take_bias(FittedGyroBias(np.full(3, 0.05), np.eye(3) * 0.005**2))
    assert follower.gyro_bias.rate == bias
    assert follower.newest == up


def test_a_window_with_a_rest_gives_no_bias():
    """Its rates are without the bias at the rest, which up knows already."""
    robot, window = circles()
    window = window.take(window.time < 25.0)
    rested = dataclasses.replace(window, sigma_before=0.0005)
    assert fit(rested, known(robot)).gyro is None
