"""Fixtures of the tests of reports."""

import pytest
from remembered import remembered

from magcal_ros.report import turn

EXAMINE_WINDOW = remembered(turn.examine_window)


@pytest.fixture(autouse=True)
def one_look(monkeypatch):
    """Examine the sensors of one turn once: it takes half the time of a report."""
    monkeypatch.setattr(turn, "examine_window", EXAMINE_WINDOW)
