"""The number of repetitions of a fault: few in each test run, many with `make soak`."""

import os

import pytest

IS_LONG = "MAGCAL_SOAK" in os.environ


def rounds(short, long):
    """The number of repetitions."""
    return long if IS_LONG else short


def first_of(values, count=1):
    """Return parameters of a test: the first always, the others with `make nightly` alone."""
    values = list(values)
    others = (pytest.param(value, marks=pytest.mark.nightly) for value in values[count:])
    return [*values[:count], *others]
