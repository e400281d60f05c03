"""What the tests of commands share."""

import sys

import pytest


@pytest.fixture(autouse=True)
def no_pictures(monkeypatch):
    """Draw no pictures in this process, as where matplotlib is missing: they are half of a fit."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
