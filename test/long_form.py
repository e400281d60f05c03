"""How often a fault is tried: a short form with every test run, a long one with `make soak`."""

import os

IS_LONG = "MAGCAL_SOAK" in os.environ


def rounds(short, long):
    """How often to try."""
    return long if IS_LONG else short
