"""A heading that is told again and again, and the gyro."""

import math

import numpy as np
import pytest

from magcal_ros.core.session.external_heading import HeadingAgainstGyro, TurnSince


@pytest.mark.parametrize(
    ("read", "named"),
    [
        (lambda yaw: yaw, ""),
        (lambda yaw: -yaw, "mirrored"),
        (lambda yaw: 0.5 * math.pi - yaw, "bearing"),
        (lambda yaw: math.degrees(yaw), "degrees were published as radians"),
        (lambda yaw: math.radians(yaw), "radians were taken for degrees"),
        (lambda yaw: 0.7, "repeats an old heading"),
    ],
)
def test_a_heading_that_turns_otherwise_than_the_gyro_is_named(read, named):
    check, rng, yaw = HeadingAgainstGyro(), np.random.default_rng(1), 0.4
    for k in range(600):
        turn = 0.1 * 0.7 * math.sin(0.05 * k)
        yaw += turn
        told = read(yaw) + math.radians(0.05) * rng.standard_normal()
        check.add(100.0 + 0.1 * k, math.remainder(told, math.tau), yaw)
    assert (named in check.fault) if named else not check.fault


def test_the_turn_since_a_standing_knows_how_sure_it_is():
    since = TurnSince()
    assert math.isinf(since.sigma)
    for k in range(501):
        since.add(0.02 * k, (0.0, 0.0, 1.0), (0.3, 0.0, 0.2), 1e-6)
    assert since.angle == pytest.approx(2.0)
    assert math.radians(0.5) < since.sigma < math.radians(2.0)
    since.add(20.0, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 1e-6)
    assert math.isinf(since.sigma)
