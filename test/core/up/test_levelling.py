import math

import pytest

from magcal_ros.core.up import Levelling


def after(forces, step=0.01):
    level = Levelling(forces[0])
    for force in forces[1:]:
        level.add(force, step)
    return level


def test_up_is_the_direction_of_the_force():
    level = after([(0.0, 0.3, 0.9)] * 10)
    assert level.up == pytest.approx((0.0, 0.3 / math.hypot(0.3, 0.9), 0.9 / math.hypot(0.3, 0.9)))


def test_a_new_direction_is_reached_within_half_a_second():
    level = after([(0.0, 0.0, 1.0)] * 100 + [(0.1, 0.0, 1.0)] * 50)
    assert level.up[0] == pytest.approx(0.1, abs=0.005)


def test_a_longer_force_has_the_variance_of_the_acceleration_that_explains_it():
    calm = after([(0.0, 0.0, 1.0)] * 1000)
    pulled = after([(0.0, 0.0, 1.0)] * 1000 + [(0.15, 0.0, 1.0)] * 300)
    assert calm.variance < 0.005**2
    assert math.sqrt(pulled.variance) > 0.08


def test_opposite_forces_do_no_harm():
    level = after([(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.0, 0.0, 1.0)], step=10.0)
    assert math.isfinite(level.variance)
