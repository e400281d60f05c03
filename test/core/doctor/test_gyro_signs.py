import numpy as np
import pytest
from long_form import first_of
from simulated.turns import measure, smooth_wobble, turn

from magcal_ros.core.doctor.page import wrong_axes
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import Window
from magcal_ros.core.simulation import Robot


def is_refused(window):
    return wrong_axes(window, Knowledge()) is not None


def leaning_turn(seed=1):
    robot = Robot(gyro_bias=np.array([0.02, -0.01, 0.03]))
    rng = np.random.default_rng(seed)
    wobble = smooth_wobble(rng, 500, 15.0, 0.1)
    return measure(robot, turn(wobble=wobble), rng, gyro=True)


def with_signs(window, signs):
    rate = window.angular_rate * np.array(signs)
    return Window(window.time, window.field, window.specific_force, rate)


@pytest.mark.parametrize("seed", first_of(range(5)))
def test_a_true_gyro_is_believed(seed):
    assert not is_refused(leaning_turn(seed))


@pytest.mark.parametrize("signs", first_of([(-1, -1, 1), (-1, -1, -1), (1, 1, -1), (1, -1, 1)]))
def test_axes_that_turn_the_wrong_way_are_found(signs):
    found = wrong_axes(with_signs(leaning_turn(), signs), Knowledge())
    assert "the gyro's axes are not the accelerometer's" in str(found)


def test_of_a_gyro_that_is_absent_nothing_is_said():
    assert not is_refused(measure(Robot(), turn(), np.random.default_rng(1)))
