"""Fixtures of the tests of commands."""

import sys

import pytest
from remembered import remembered

from magcal_ros.cli import check
from magcal_ros.core.doctor import SensorReport, sensor_report, turn_fit
from magcal_ros.core.multi_turn import joined
from magcal_ros.core.session import recorded
from magcal_ros.report import turn

CALIBRATE = remembered(recorded.calibrate)
CALIBRATE_TURNS = remembered(recorded.calibrate_turns)
CHECK = remembered(check.check)
SMOOTH = remembered(turn_fit.smooth)


@pytest.fixture(autouse=True)
def plain_reports(monkeypatch):
    """Draw no pictures in this process, and do not look at the sensors: it is half of a fit."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr(turn, "examine_window", lambda *_: SensorReport(()))
    monkeypatch.setattr(joined, "wrong_axes", lambda *_: None)


@pytest.fixture(autouse=True)
def one_fit(monkeypatch):
    """Fit the same samples once for all commands."""
    monkeypatch.setattr(recorded, "calibrate", CALIBRATE)
    monkeypatch.setattr(recorded, "calibrate_turns", CALIBRATE_TURNS)
    monkeypatch.setattr(check, "check", CHECK)
    monkeypatch.setattr(turn_fit, "smooth", SMOOTH)


@pytest.fixture
def right_axes(monkeypatch):
    """Look for no wrong axes after a quick fit, which takes a tenth of that time."""
    monkeypatch.setattr(sensor_report, "wrong_axes", lambda *_: None)


@pytest.fixture
def axes_alone(monkeypatch):
    """Fit no turn after the axes are found: it takes most of the time, and changes none."""
    monkeypatch.setattr(sensor_report, "fit_turn", lambda *_: None)
