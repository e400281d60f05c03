"""Long drives under a calibration that holds, and under one that no longer does."""

import math

import numpy as np
import pytest
from driving import PERIOD, ROBOT, Route, changed, drive, promise
from long_form import first_of

from magcal_ros.core import Compass, Grade, Knowledge, Window, calibrate
from magcal_ros.core.heading import CompassReading
from magcal_ros.core.monitoring import CalibrationMonitor, MonitorTuning
from magcal_ros.core.samples import FieldSample, ImuSample
from magcal_ros.core.up import UpFollower

PROMISE = promise()


def monitored(robots, minutes, way=Route(), **options):
    """The monitor after the drive, and all its results during the drive."""
    watch = CalibrationMonitor(PROMISE)
    return watch, drive(watch, PROMISE, robots, minutes, way, **options)


def doubts(watch):
    return {f.figure.value: f for f in watch.result.findings if f.grade.rank >= Grade.WARN.rank}


@pytest.mark.parametrize(
    "way",
    first_of(
        [
            Route(turns=(1.0,), slope=math.radians(3.0)),
            Route(steel=0.05 * ROBOT.strength),
            Route(headings=(0.0, math.pi)),
            Route(),
        ]
    ),
    ids=["left turns on slopes", "steel", "corridor", "plain"],
)
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.nightly)])
def test_a_drive_without_a_change_gives_no_warning(way, seed):
    watch, stated = monitored([ROBOT], [15 if seed > 1 else 8], way, seed=seed)
    assert not any(word.is_stale for _, word in stated)
    assert stated[-1][1].was_judged
    assert "holds" in watch.result.summary or "held" in watch.result.summary


@pytest.mark.parametrize("gyro", first_of([False, True]))
@pytest.mark.parametrize("shift", first_of([(2.5, 0.0), (-1.8, 1.8)]))
def test_hard_iron_of_a_twentieth_of_the_field_is_found_with_its_size(shift, gyro):
    watch, stated = monitored([ROBOT, changed(*shift)], [6, 9], gyro=gyro, seed=3)
    assert not any(word.is_stale for stamp, word in stated if stamp < 1000.0 + 6 * 60.0)
    assert watch.result.is_stale
    assert "hard_iron_change" in doubts(watch)
    assert np.array(watch.result.hard_iron) * 1e6 == pytest.approx(shift, abs=0.5)
    assert watch.result.minutes == pytest.approx(9.0, abs=2.0)
    assert "calibrate again" in watch.result.summary


def test_a_small_change_gives_no_warning():
    _, stated = monitored([ROBOT, changed(1.0)], [5, 10])
    assert not any(word.is_stale for _, word in stated)


@pytest.mark.parametrize(
    "case",
    first_of(
        [
            (changed(roll=ROBOT.roll + math.radians(5.0)), "mounting_change", 5.0),
            (changed(soft_iron=np.diag([0.06, -0.06, 0.0])), "soft_iron_change", 6.0),
            (changed(strength=40e-6), "strength_shift", 20.0),
            (changed(inclination=math.radians(45.0)), "dip_shift", 15.0),
            (changed(20.0), "hard_iron_change", 40.0),
            (changed(pitch=ROBOT.pitch - math.radians(5.0)), "mounting_change", 5.0),
            (changed(soft_iron=0.12 * np.eye(3)), "strength_shift", 12.0),
        ],
        3,
    ),
)
def test_each_change_is_named(case):
    robot, figure, size = case
    watch, _ = monitored([ROBOT, robot], [4, 9])
    assert watch.result.is_stale
    found = doubts(watch)
    assert found[figure].value == pytest.approx(size, rel=0.2)
    if figure in ("strength_shift", "dip_shift"):
        assert "another place" in watch.result.summary
        assert not {"hard_iron_change", "mounting_change", "soft_iron_change"} & set(found)


def test_a_magnet_that_hides_the_headings_is_found_by_the_gyro():
    watch, _ = monitored([ROBOT, changed(40.0)], [4, 7])
    assert "gyro_compass_harmonic" in doubts(watch)


def test_the_warning_ends_when_the_field_returns():
    watch, stated = monitored([ROBOT, changed(5.0), ROBOT], [4, 8, 12])
    assert any(word.is_stale for _, word in stated)
    assert not watch.result.is_stale


def test_a_rest_beside_a_car_is_no_change_and_later_there_is_no_data():
    watch = CalibrationMonitor(PROMISE)
    way = Route(parked=(300.0, 1500.0))
    stated = drive(watch, PROMISE, [ROBOT, changed(8.0, 5.0), ROBOT], [5, 20, 6], way)
    assert not any(word.is_stale for _, word in stated)
    parked = [word for stamp, word in stated if 2200.0 < stamp < 2490.0]
    assert all("not enough" in word.missing_data for word in parked)
    assert "held when it was last judged" in parked[0].summary


def test_nothing_is_judged_before_there_is_enough_data():
    watch, _ = monitored([changed(20.0)], [1])
    assert not watch.result.is_stale
    assert watch.result.summary.startswith("Not judged yet: ")


@pytest.mark.nightly
def test_an_uncertain_calibration_is_judged_by_its_sigma():
    poor = promise(heading_sigma=math.radians(4.0))
    watch = CalibrationMonitor(poor)
    drive(watch, poor, [changed(2.5)], [10])
    assert watch.result.was_judged
    assert not watch.result.is_stale


def test_memory_is_bounded_and_time_set_back_restarts_the_monitor():
    watch, _ = monitored([ROBOT], [12])
    assert len(watch._records) <= MonitorTuning.most_records
    drive(watch, PROMISE, [ROBOT], [1], start=10.0)
    assert len(watch._records) < 100
    assert not watch.result.is_stale


@pytest.mark.nightly
@pytest.mark.parametrize("hours", first_of([5.0, -0.2]))
def test_a_jump_of_time_does_not_age_a_warning(hours):
    watch, _ = monitored([changed(4.0)], [9], seed=3)
    minutes = watch.result.minutes
    assert watch.result.is_stale
    drive(watch, PROMISE, [changed(4.0)], [6], start=1540.0 + hours * 3600.0, seed=3)
    assert watch.result.is_stale
    assert minutes <= watch.result.minutes < minutes + 7.0


@pytest.mark.nightly
def test_gaps_and_repeats_do_no_harm():
    class Holed(CalibrationMonitor):
        def take(self, moment):
            if moment.stamp % 20.0 > 3.0:
                super().take(moment)
                super().take(moment)

    watch = Holed(PROMISE)
    stated = drive(watch, PROMISE, [ROBOT], [14])
    assert stated[-1][1].was_judged
    assert not any(word.is_stale for _, word in stated)
    assert PERIOD < 3.0


def ride_along(recording, calibration, shift, repeats):
    """Monitor a recording repeatedly, with a hard iron added in the second half."""
    watch, compass, carried = CalibrationMonitor(calibration), Compass(calibration), UpFollower()
    imu, mag, length = recording
    for lap in range(repeats):
        extra = shift if 2 * lap >= repeats else np.zeros(3)
        for (t, *inertial), (_, *raw) in zip(imu, mag, strict=True):
            sample = ImuSample(t + lap * length, tuple(inertial[:3]), tuple(inertial[3:]))
            carried.add(sample)
            added = FieldSample(sample.stamp, tuple(raw + extra))
            up = carried.at(sample.stamp, 0.0)
            watch.take(CompassReading.of(compass, added, up, sample.rate))
    return watch


@pytest.mark.nightly
@pytest.mark.parametrize("added", [0.0, 5e-6])
def test_a_recorded_drive_holds_until_iron_is_added(recording, added):
    folder = recording("broad05")
    imu, mag = (np.loadtxt(folder / f"{n}.csv", delimiter=",", skiprows=1) for n in ("imu", "mag"))
    turn = (imu[:, 0] > 48.0) & (imu[:, 0] < 62.0)
    window = Window(imu[turn, 0], mag[turn, 1:4], imu[turn, 1:4], imu[turn, 4:7])
    calibration = calibrate(window, Knowledge()).calibration
    imu, mag = imu[::4], mag[::4]
    length = float(imu[-1, 0] - imu[0, 0]) + 0.05
    watch = ride_along((imu, mag, length), calibration, np.array([added, 0.0, 0.0]), 6)
    print(watch.result)
    assert watch.result.is_stale == bool(added)
