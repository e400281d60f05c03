import numpy as np
import pytest

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import Belief, Knowledge, ReferenceField
from magcal_ros.core.methods.maximum_likelihood import fit
from magcal_ros.core.simulator import DEGREE, Robot, measure, turn
from magcal_ros.core.window import Window


def window_of(robot=None, seed=1, **motion):
    return measure(robot or Robot(), turn(**motion), np.random.default_rng(seed))


def refusal(window, knowledge=None):
    with pytest.raises(Refusal) as caught:
        fit(window, Robot().knowledge() if knowledge is None else knowledge)
    assert len(str(caught.value)) > 30
    return caught.value.reason


def test_too_few_samples():
    assert refusal(window_of(samples=19)) is Reason.TOO_FEW_SAMPLES


def test_no_motion():
    assert refusal(window_of(arc=0.0)) is Reason.NO_MOTION


@pytest.mark.parametrize("arc", [15.0, 30.0, 40.0])
def test_an_arc_too_short(arc):
    window = window_of(arc=arc * DEGREE)
    assert refusal(window) in {Reason.ARC_TOO_SHORT, Reason.NO_MOTION}


def test_a_short_arc_needs_the_field_or_a_gyro():
    assert refusal(window_of(arc=60 * DEGREE), Knowledge()) is Reason.ARC_TOO_SHORT
    fit(window_of(arc=60 * DEGREE), Robot().knowledge())


def test_field_of_noise():
    rng = np.random.default_rng(1)
    plain = window_of()
    noise = Window(plain.time, 30e-6 * rng.standard_normal((500, 3)), plain.specific_force)
    assert refusal(noise) in {Reason.FIELD_NOT_ON_A_PLANE, Reason.NO_MOTION}


def test_a_field_too_steep():
    robot = Robot(inclination=84 * DEGREE)
    assert refusal(window_of(robot), robot.knowledge()) is Reason.FIELD_TOO_STEEP
    reference = ReferenceField(Belief(robot.strength), Belief.unknown())
    reasons = {Reason.FIELD_TOO_STEEP, Reason.CIRCLE_TOO_SMALL, Reason.AMBIGUOUS}
    assert refusal(window_of(robot), Knowledge(reference)) in reasons


def test_an_axis_along_the_field():
    robot = Robot()
    start = (0.0, 0.0, 90 * DEGREE)
    axis = np.array([np.cos(robot.inclination), 0.0, -np.sin(robot.inclination)])
    window = window_of(robot, axis=axis, start_rpy=start)
    assert refusal(window) is Reason.AXIS_ALONG_FIELD


def test_sensors_that_are_silent():
    plain = window_of()
    nothing = np.zeros((500, 3))
    assert refusal(Window(plain.time, nothing, plain.specific_force)) is Reason.FIELD_ABSENT
    assert refusal(Window(plain.time, plain.field, nothing)) is Reason.GRAVITY_ABSENT


def test_a_gyro_that_belongs_to_another_robot():
    plain = window_of()
    rate = np.zeros((500, 3))
    rate[:, 2] = 3.0 * np.sin(3.0 * plain.time)
    window = Window(plain.time, plain.field, plain.specific_force, rate)
    assert refusal(window) is Reason.AXES_DISAGREE
