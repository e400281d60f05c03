"""Repeated headings of another device, compared with the gyro."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from magcal_ros.core.samples import ImuSample
from magcal_ros.core.session import GyroTurn, HeadingAgainstGyro
from magcal_ros.core.up import UpFollower


@pytest.mark.parametrize(
    ("read", "named"),
    [
        (lambda yaw: yaw, ""),
        (lambda yaw: -yaw, "mirrored"),
        (lambda yaw: 0.5 * math.pi - yaw, "bearing"),
        (lambda yaw: math.degrees(yaw), "degrees were published as radians"),
        (lambda yaw: math.radians(yaw), "converted as if they were degrees"),
        (lambda yaw: 0.7, "repeats an old heading"),
    ],
)
def test_a_heading_that_contradicts_the_gyro_is_reported(read, named):
    check, rng, yaw = HeadingAgainstGyro(), np.random.default_rng(1), 0.4
    for k in range(600):
        turn = 0.1 * 0.7 * math.sin(0.05 * k)
        yaw += turn
        reported = read(yaw) + math.radians(0.05) * rng.standard_normal()
        check.add(100.0 + 0.1 * k, math.remainder(reported, math.tau), yaw)
    assert (named in check.fault) if named else not check.fault


def following(rate, bias_variance=1e-6):
    """What a turn reads of an up follower: the mean rate, rad/s, and the variance of the bias."""
    bias = SimpleNamespace(variance=bias_variance)
    return SimpleNamespace(
        newest=(0.0, 0.0, 1.0), is_propagated=True, mean_rate=rate, gyro_bias=bias
    )


def turned(seconds, bias_variance=1e-6):
    turn, up = GyroTurn(), following((0.3, 0.0, 0.2), bias_variance)
    for k in range(int(50 * seconds) + 1):
        turn = turn.followed(0.02 * k, up)
    return turn


def test_the_turn_since_a_measurement_has_a_correct_sigma():
    assert math.isinf(GyroTurn().sigma)
    turn = turned(10.0)
    assert turn.angle == pytest.approx(2.0)
    assert turn.seconds == pytest.approx(10.0)
    assert math.radians(0.3) < turn.sigma < math.radians(1.0)
    later = turn.followed(20.0, following((0.0, 0.0, 0.0)))
    assert math.isinf(later.sigma)
    # After a gap the turn is known again.
    assert later.followed(20.02, following((0.0, 0.0, 0.2))).since(later).sigma < 0.01


def test_a_turn_is_unknown_while_the_gyro_is_not_used():
    up, rng, turns = UpFollower(), np.random.default_rng(1), [GyroTurn()]
    for k in range(600):
        rate = (0.0, 0.0, 0.2 + 1e-3 * rng.standard_normal())
        is_silent = 200 <= k < 400
        stamp, force = 0.01 * k, tuple(np.array([0.0, 0.0, 9.81]) + 0.01 * rng.standard_normal(3))
        up.add(ImuSample(stamp, force, (math.nan,) * 3 if is_silent else rate))
        turns.append(turns[-1].followed(stamp, up))
    assert turns[199].since(turns[100]).sigma < 0.01
    assert math.isinf(turns[-1].since(turns[100]).sigma)
    assert turns[-1].since(turns[450]).sigma < 0.01


def test_a_turn_is_less_certain_without_a_rest_and_after_minutes():
    assert turned(10.0, 0.01**2).sigma == pytest.approx(10.0 * 0.01, rel=0.1)
    # A bias that walks is no constant one.
    assert turned(300.0).sigma > math.radians(5.0)
