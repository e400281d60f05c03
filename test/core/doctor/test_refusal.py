"""A turn with a gyro that does not measure it, or in another unit, is refused with the reason."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from remembered import remembered
from simulated.drive import Vehicle, simulated_drive
from simulated.legs import Leg
from simulated.travel import travel
from simulated.turns import Motion, measure, smooth_wobble, turn

from magcal_ros.core import Grade, Knowledge, Reason, Refusal, Window, calibrate
from magcal_ros.core.doctor import (
    alive_finding,
    compare_axes,
    fit_turn,
    motion,
    refusal_by_sensors,
    wrong_axes,
)
from magcal_ros.core.geometry import rotation_from_rpy
from magcal_ros.core.knowledge import Mounting
from magcal_ros.core.samples import ImuSample, SensorLog
from magcal_ros.core.session import SampleCollector, fit_collected
from magcal_ros.core.simulation import Ride, Robot


@pytest.fixture(scope="module")
def window():
    return turned_and_swayed(0.0175)


def turned_and_swayed(radians):
    rng = np.random.default_rng(2)
    sway = smooth_wobble(rng, 300, 20.0, radians, (0.2, 2.0))
    motion = turn(arc=6.8, samples=300, duration=20.0, start_rpy=(0.02, 0.03, 0.0), wobble=sway)
    robot = Robot(noise_field=0.3e-6, noise_force=0.05, noise_rate=2e-3)
    return measure(robot, motion, rng, gyro=True)


def with_rate(window, *axes):
    """The window with other axes of its gyro; None for one that is dead."""
    columns = [np.zeros(len(window)) if k is None else window.angular_rate[:, k] for k in axes]
    return replace(window, angular_rate=np.column_stack(columns))


def test_a_good_gyro_is_not_refused(window):
    assert wrong_axes(window, Knowledge()) is None


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ((0, 1, None), "the gyro's z never changes"),
        ((2, None, None), "y and z never change: the driver does not read them, and publishes the "
         "turn about z as x"),
    ],
)  # fmt: skip
def test_a_dead_z_axis_is_named_with_the_remedy(window, axes, words):
    turned = with_rate(window, *axes)
    found = wrong_axes(turned, Knowledge())
    assert found.reason is Reason.AXES_DISAGREE
    assert words in str(found)
    assert "calibrated without a gyro" in str(found)
    unseen = Refusal(Reason.ARC_TOO_SHORT, "nothing was seen of a turn")
    assert words in str(refusal_by_sensors(unseen, turned, Knowledge()))


def test_a_simulator_without_noise_may_turn_about_one_axis_alone():
    robot = Robot(noise_rate=0.0)
    window = measure(robot, turn(samples=300), np.random.default_rng(1), gyro=True)
    level = with_rate(window, None, None, 2)
    assert wrong_axes(level, Knowledge()) is None
    assert calibrate(level, robot.knowledge()).verdict.accepted


def test_a_dead_z_axis_is_refused_before_the_fit(window, monkeypatch):
    # The package's attribute of that name is the function.
    module = sys.modules["magcal_ros.core.calibrate"]
    monkeypatch.setattr(module, "find_method", pytest.fail)
    outcome = calibrate(with_rate(window, 0, 1, None), Knowledge())
    assert not outcome.verdict.accepted
    assert "the gyro's z never changes" in outcome.verdict.summary


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ((None, None, 2), "the gyro's x and y never change"),
        pytest.param((0, None, 2), "the gyro's y never changes", marks=pytest.mark.nightly),
    ],
)
def test_a_gyro_that_measures_about_z_calibrates_a_turn_between_rests(axes, words):
    legs = [Leg(6.0), Leg(25.0, turn_rate=math.tau / 25.0), Leg(6.0)]
    rng = np.random.default_rng(40)
    vehicle = Vehicle(Robot(noise_rate=2e-3))
    drive = simulated_drive(travel(legs, rng, rate=15.0), rng, vehicle, streets=None)
    turned = with_rate(Window(drive.time, drive.field, drive.force, drive.rate), *axes)
    assert wrong_axes(turned, Knowledge()) is None
    outcome = calibrate(turned, Knowledge())
    assert outcome.verdict.accepted
    off = outcome.calibration.correction.hard_iron - vehicle.robot.hard_iron
    assert np.abs(off[:2]).max() < 1e-6
    found = alive_finding("gyro", turned.angular_rate, turned.specific_force)
    assert found.grade is Grade.WARN
    assert words in found.remedy
    assert "a turn on the spot between two rests can be calibrated" in found.remedy


@pytest.mark.nightly
def test_without_the_gyro_that_has_dead_axes_the_turn_is_calibrated(window):
    assert calibrate(replace(window, angular_rate=None), Knowledge()).verdict.accepted


@pytest.mark.parametrize("since", first_of([100, 0]))
def test_a_stuck_gyro_is_reported(window, since):
    rate = window.angular_rate.copy()
    rate[since:] = [0.1, 0.02, -0.05]
    outcome = calibrate(replace(window, angular_rate=rate), Knowledge())
    assert not outcome.verdict.accepted
    assert "the gyro is frozen" in outcome.verdict.summary
    unseen = Refusal(Reason.ARC_TOO_SHORT, "nothing was seen of a turn")
    assert "the gyro is frozen" in str(
        refusal_by_sensors(unseen, replace(window, angular_rate=rate), Knowledge())
    )


@pytest.mark.parametrize("sensors", [["force"], ["rate"], ["force", "rate"]])
def test_an_imu_that_repeats_one_message_is_reported(sensors):
    """The heading was off by several of its sigmas: the one reading's error was taken for tilt."""
    ride = Ride(Robot(), np.random.default_rng(3), start=1000.0)
    samples = [sample for _ in range(350) for sample in ride.step(0.5)]
    first = next(each for each in samples if isinstance(each, ImuSample))
    held = {name: getattr(first, name) for name in sensors}
    collector = SampleCollector(Mounting())
    collector.take(
        each._replace(**held) if isinstance(each, ImuSample) else each for each in samples
    )
    outcome = fit_collected(collector, Robot().knowledge())
    assert not outcome.verdict.accepted
    for name in sensors:
        of = {"force": "accelerometer", "rate": "gyro"}[name]
        assert f"the {of} is frozen" in outcome.verdict.summary


def test_rates_in_another_unit_are_reported(window):
    outcome = calibrate(replace(window, angular_rate=562.0 * window.angular_rate), Knowledge())
    assert outcome.reason is Reason.AXES_DISAGREE
    assert "the gyro's rates are 562 times too large" in outcome.verdict.summary


def test_rates_in_another_unit_are_not_explained_as_they_are(window, monkeypatch):
    fastest = []

    def explained(log, *others):
        fastest.append(np.abs(log.rate).max())
        return compare_axes(log, *others)

    monkeypatch.setattr(motion, "compare_axes", explained)
    outcome = calibrate(replace(window, angular_rate=57.3 * window.angular_rate), Knowledge())
    assert "degrees/s published as rad/s" in outcome.verdict.summary
    # That would take four times as long, and nothing fits.
    assert max(fastest) < 2.0 * np.abs(window.angular_rate).max()


KNOWN = Robot().knowledge()
QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Axes of a magnetometer that is turned by 90° about z."""


@remembered
def compared(window):
    """The comparison of all axes, and the fit of the likeliest."""
    found = compare_axes(SensorLog.of_window(window), KNOWN.reference.inclination)
    return found, motion.diagnose_axes(found, KNOWN, None, up_is_down=False)


def worsened(found, times=200.0):
    """The same comparison, with a worse cost of the axes as given."""
    return replace(found, base=found.base + times * (np.arange(len(found.base)) == found.as_given))


def test_axes_as_given_are_kept_if_the_smoother_excludes_the_others():
    """The comparison has a simple model, and a short turn there and back misled it."""
    found, named = compared(turned_and_swayed(0.1))
    assert named.chosen == found.as_given
    again = motion.diagnose_axes(worsened(found, 1000.0), KNOWN, None, up_is_down=False)
    assert again.chosen == found.as_given
    assert again.turn is not None  # the report needs no second fit
    assert not any(each.is_wrong for each in again.findings)


def test_axes_that_no_fit_can_use_are_those_of_the_comparison(window, monkeypatch):
    found = worsened(compared(window)[0])
    monkeypatch.setattr("magcal_ros.core.doctor.axes_diagnosis.fit_turn", lambda *_: None)
    named = motion.diagnose_axes(found, KNOWN, None, up_is_down=False)
    assert named.chosen != found.as_given
    assert any(each.is_wrong for each in named.findings)


def test_the_fit_by_other_axes_is_that_of_right_sensors(window):
    found, _ = compared(window)
    right = found.hypothesis(found.as_given)
    log = replace(right.log, field=right.log.field @ QUARTER_TURN.T)
    turned = right._replace(field=QUARTER_TURN, log=log)
    odds = [fit_turn(each, KNOWN, up_is_down=False).log_odds for each in (right, turned)]
    assert odds[1] == pytest.approx(odds[0], abs=1e-6)


def test_a_coarse_magnetometer_that_stops_on_its_way_is_not_frozen():
    """The samples begin in motion, so the first rates are not the gyro's bias."""
    time = np.arange(0.0, 24.0, 0.05)
    yaw = np.cumsum(np.where(time % 6.0 < 3.0, 0.7, 0.0)) * 0.05
    attitude = np.array([rotation_from_rpy(0.02, 0.01, each).T for each in yaw])
    robot = Robot(noise_field=0.01e-6, noise_force=0.05, noise_rate=2e-3)
    rng = np.random.default_rng(3)
    fine = measure(robot, Motion(time, attitude), rng, gyro=True)
    coarse = replace(fine, field=np.round(fine.field / 0.5e-6) * 0.5e-6)
    assert wrong_axes(coarse, Knowledge()) is None
    assert calibrate(coarse, robot.knowledge()).verdict.accepted
