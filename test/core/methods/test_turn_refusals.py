import numpy as np
import pytest
from long_form import first_of
from simulated.turns import Motion, measure, turn

from magcal_ros.core import Belief, Knowledge, Reason, ReferenceField, Refusal, Window, calibrate
from magcal_ros.core.geometry import rotation_about
from magcal_ros.core.methods.smoother import fit
from magcal_ros.core.simulation import DEGREE, LEVEL_TILT, UP_ENU, Robot, heading_errors


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


@pytest.mark.parametrize("arc", first_of([40.0, 15.0, 30.0]))
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
    robot = Robot(inclination=88 * DEGREE)
    assert refusal(window_of(robot), robot.knowledge()) is Reason.FIELD_TOO_STEEP
    reference = ReferenceField(Belief(robot.strength), Belief.unknown())
    reasons = {Reason.FIELD_TOO_STEEP, Reason.CIRCLE_TOO_SMALL, Reason.AMBIGUOUS}
    assert refusal(window_of(robot), Knowledge(reference)) in reasons


@pytest.mark.parametrize("known", first_of([True, False]))
def test_a_steep_field_that_a_compass_can_use_is_used(known):
    robot = Robot(inclination=78 * DEGREE, noise_field=0.2e-6)
    knowledge = robot.knowledge(1.5e-6, 1.0 * DEGREE) if known else Knowledge()
    estimate = fit(window_of(robot, start_rpy=(3.0 * DEGREE, 0.0, 1.0)), knowledge)
    gap = heading_errors(estimate.correction, robot)[:, LEVEL_TILT]
    assert np.sqrt(np.mean(gap**2)) < 0.5 * DEGREE


def test_an_axis_along_the_field():
    robot = Robot()
    start = (0.0, 0.0, 90 * DEGREE)
    axis = np.array([np.cos(robot.inclination), 0.0, -np.sin(robot.inclination)])
    window = window_of(robot, axis=axis, start_rpy=start)
    assert refusal(window) is Reason.AXIS_ALONG_FIELD


@pytest.mark.parametrize("method", ["maximum_likelihood", "design_tip"])
def test_stamps_that_are_not_seconds(method):
    """Nanoseconds took all of the memory."""
    window = window_of()
    window = Window(1e9 * window.time, window.field, window.specific_force, window.angular_rate)
    outcome = calibrate(window, Robot().knowledge(), method)
    assert "they must be seconds" in outcome.verdict.summary


@pytest.mark.parametrize("gyro", [True, False])
def test_stamps_in_milliseconds(gyro):
    """Without a gyro a calibration was accepted; with one its fit took minutes."""
    window = measure(Robot(), turn(samples=400), np.random.default_rng(3), gyro=gyro)
    window = Window(1e3 * window.time, window.field, window.specific_force, window.angular_rate)
    verdict = calibrate(window, Robot().knowledge()).verdict
    assert not verdict.accepted
    assert "not milliseconds" in verdict.summary


def test_sensors_without_values():
    plain = window_of()
    nothing = np.zeros((500, 3))
    assert refusal(Window(plain.time, nothing, plain.specific_force)) is Reason.FIELD_ABSENT
    assert refusal(Window(plain.time, plain.field, nothing)) is Reason.GRAVITY_ABSENT


def test_a_gyro_of_another_robot():
    plain = window_of(samples=400)
    rate = np.zeros((400, 3))
    rate[:, 2] = 3.0 * np.sin(3.0 * plain.time)
    window = Window(plain.time, plain.field, plain.specific_force, rate)
    assert not calibrate(window, Robot().knowledge()).verdict.accepted


@pytest.mark.nightly
def test_a_magnetometer_that_is_upside_down_is_named():
    robot = Robot(roll=175 * DEGREE, pitch=5 * DEGREE)
    window = measure(robot, turn(samples=200), np.random.default_rng(7), gyro=True)
    verdict = calibrate(window, robot.knowledge()).verdict
    assert not verdict.accepted
    assert "mount_rpy_deg: [180.0, 0.0, 0.0]" in verdict.summary


def words_of(window, knowledge=None):
    with pytest.raises(Refusal) as caught:
        fit(window, Robot().knowledge() if knowledge is None else knowledge)
    return str(caught.value)


def test_a_field_that_does_not_follow_the_turn_is_reported_with_its_residual():
    clean = window_of(samples=150)
    phase = np.linspace(0.0, 2.0 * np.pi, len(clean))[:, None] * [7.0, 9.0, 11.0]
    words = words_of(Window(clean.time, clean.field + 25e-6 * np.sin(phase), clean.specific_force))
    assert "the field deviates by" in words
    assert "100% of the samples fit" not in words


def test_a_turn_of_the_gyro_alone_is_not_reported_as_no_motion():
    robot = Robot(inclination=90.0 * DEGREE)
    window = measure(robot, turn(), np.random.default_rng(1), gyro=True)
    field = np.broadcast_to(window.field.mean(axis=0), window.field.shape)
    still = Window(window.time, field, window.specific_force, window.angular_rate)
    words = words_of(still, Knowledge())
    assert "the gyro shows a turn of 359 degrees" in words
    assert "did not turn" not in words
    assert "the robot did not turn" in words_of(Window(*[*samples_of(still)]), Knowledge())


def samples_of(window):
    return window.time, window.field, window.specific_force


@pytest.mark.parametrize("seeds", first_of([1, 4]))
def test_noise_at_rest_does_not_lengthen_the_arc(seeds):
    robot = Robot(noise_field=0.5e-6, noise_force=0.05)
    yaw = np.clip(np.linspace(-20.0, 100.0, 600), 0.0, 80.0) * DEGREE
    motion = Motion(np.linspace(0.0, 20.0, 600), rotation_about(UP_ENU, -yaw))
    arcs = [
        fit(measure(robot, motion, np.random.default_rng(seed)), robot.knowledge()).arc
        for seed in range(seeds)
    ]
    assert np.mean(arcs) == pytest.approx(80.0 * DEGREE, abs=2.0 * DEGREE)
