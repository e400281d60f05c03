"""The drawn deviation of gyro from compass is the judged one."""

import math

import numpy as np
import pytest
from drives import ROBOT
from long_form import first_of
from simulated.turns import measure, turn

from magcal_ros.core import METHODS, Figure, Knowledge, Window, calibrate
from magcal_ros.core.assessment import TURN_BOUNDS
from magcal_ros.core.doctor import SensorReport
from magcal_ros.report import turn as turn_module
from magcal_ros.report.gallery import caption_of_gyro, deviations
from magcal_ros.report.turn import Subject, Turn


@pytest.fixture(autouse=True)
def no_look(monkeypatch):
    """The part of the page on the sensors is not used here."""
    monkeypatch.setattr(turn_module, "examine_window", lambda *_: SensorReport(()))


def shown(window, knowledge):
    outcome = calibrate(window, knowledge, METHODS[0])
    subject = Subject(window, knowledge, outcome, "here", METHODS[0])
    return outcome, Turn.of(subject)


def drawn_rms(picture):
    drawn = np.degrees(deviations(picture, picture.corrected)[1])
    return float(np.sqrt(np.nanmean(drawn**2)))


def read(folder):
    imu, mag = (
        np.genfromtxt(folder / f"{part}.csv", delimiter=",", skip_header=1)
        for part in ("imu", "mag")
    )
    motion = np.column_stack([np.interp(mag[:, 0], imu[:, 0], imu[:, c]) for c in range(1, 7)])
    return Window(mag[:, 0], mag[:, 1:4], motion[:, :3], motion[:, 3:])


@pytest.mark.nightly
def test_the_drawn_swing_of_a_leaning_car_is_the_judged_one(recording):
    """Its accelerometer leans by 7 degrees, which turns the compass without it by 16."""
    window = read(recording("car_circles_neu2025_kiran"))
    outcome, picture = shown(window, Knowledge())
    judged = math.degrees(outcome.estimate.figures[Figure.GYRO_COMPASS_SWING])
    assert drawn_rms(picture) == pytest.approx(judged, rel=0.3)
    words = caption_of_gyro(picture, picture.corrected)
    assert f"{judged:.1f}° rms beyond noise, which is graded" in words


@pytest.mark.nightly
@pytest.mark.parametrize("swing_deg", first_of([12.0, 20.0]))
def test_the_drawn_swing_in_a_distorted_room_is_the_judged_one(swing_deg):
    rng = np.random.default_rng(4)
    motion = turn()
    clean = measure(ROBOT, motion, rng, gyro=True)
    angle = math.radians(swing_deg) * np.sin(np.linspace(0.0, math.tau, len(clean)))
    east, north, up = ROBOT.field_enu
    bent = np.column_stack(
        [
            np.cos(angle) * east - np.sin(angle) * north,
            np.sin(angle) * east + np.cos(angle) * north,
            np.full(len(clean), up),
        ]
    )
    field = ROBOT.raw_field(np.einsum("nij,nj->ni", motion.attitude, bent))
    window = Window(clean.time, field, clean.specific_force, clean.angular_rate)
    outcome, picture = shown(window, ROBOT.knowledge())
    judged = math.degrees(outcome.estimate.figures[Figure.GYRO_COMPASS_SWING])
    assert judged > 2.0
    assert drawn_rms(picture) == pytest.approx(judged, rel=0.15)
    bound = next(b for b in TURN_BOUNDS if b.figure is Figure.GYRO_COMPASS_SWING)
    assert picture.swing_bound == bound.good


def test_a_figure_that_was_not_judged_has_no_bound():
    window = measure(ROBOT, turn(), np.random.default_rng(4), gyro=False)
    assert shown(window, ROBOT.knowledge())[1].swing_bound is None
