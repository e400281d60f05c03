"""What the tests of commands share."""

import sys

import pytest
from remembered import remembered

from magcal_ros.core.doctor import Page, page
from magcal_ros.core.multi_turn import joined
from magcal_ros.core.session import recorded
from magcal_ros.report import turn

CALIBRATE = remembered(recorded.calibrate)
CALIBRATE_TURNS = remembered(recorded.calibrate_turns)


@pytest.fixture(autouse=True)
def plain_reports(monkeypatch):
    """Draw no pictures in this process, and do not look at the sensors: it is half of a fit."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr(turn, "examine_window", lambda *_: Page(()))
    monkeypatch.setattr(joined, "wrong_axes", lambda *_: None)


@pytest.fixture(autouse=True)
def one_fit(monkeypatch):
    """Fit the same samples once, however many commands are given them."""
    monkeypatch.setattr(recorded, "calibrate", CALIBRATE)
    monkeypatch.setattr(recorded, "calibrate_turns", CALIBRATE_TURNS)


@pytest.fixture
def right_axes(monkeypatch):
    """Look for no wrong axes after a quick fit, which takes a tenth of that time."""
    monkeypatch.setattr(page, "wrong_axes", lambda *_: None)
