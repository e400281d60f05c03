"""Guessing the unit of numbers that cannot be what they claim to be."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.samples.stamps import bursts_of_a_turn
from magcal_ros.core.samples.window import Window

OF_ITS_OWN = "the field's strength there (tesla)"
FIELD_UNITS: tuple[tuple[float, float, str, str, str], ...] = (
    (0.05, 5.0, "gauss", "1e-4", "imu_3dm_gx4, Gazebo"),
    (0.7, 1.3, "a unit of its own (1 on Earth)", OF_ITS_OWN, "Xsens MTi"),
    (1.2, 1.9, "a unit of its own (1.4 on Earth)", OF_ITS_OWN, "Inertial Sense"),
    (5.0, 150.0, "microtesla", "1e-6", ""),
    (150.0, 5000.0, "milligauss", "1e-7", ""),
    (5000.0, 150_000.0, "nanotesla", "1e-9", ""),
    (80_000.0, 5e6, "a thousand times milligauss", "1e-10", "MAVROS with ArduPilot"),
)
"""Size range of a field in the Earth's when published in another unit, its name, its factor, and
the drivers that are known to publish it so."""


def likely_field_unit(size: float) -> str:
    """Say in words which units a field of `size` "tesla" may have; empty if none fits.

    Parameters
    ----------
    size : float
        Length of the field vector as published.
    """
    fitting = [
        f"looks like {name} published as tesla{f', as by {drivers}' if drivers else ''}; "
        f"multiply by {factor} in the driver"
        for low, high, name, factor, drivers in FIELD_UNITS
        if low <= size < high
    ]
    return f"a field of {size:.3g} T {'; or it '.join(fitting)}" if fitting else ""


Z_NOT_UP = (
    "z points down or sideways at rest, REP-103 wants z up; stand the robot upright or turn the "
    "axes in the driver, and check that acceleration is not published as gravity (+9.81 upwards at "
    "rest)"
)

ACCELERATION_UNITS: tuple[tuple[float, float, str, str], ...] = (
    (0.8, 1.2, "g", "9.80665"),
    (800.0, 1200.0, "milli-g", "0.00980665"),
)
"""Size range of gravity when published in another unit, its name, its factor."""


def likely_acceleration_unit(size: float) -> str:
    """Say in words which unit gravity of `size` "m/s²" probably has; empty if none fits.

    Parameters
    ----------
    size : float
        Length of the acceleration at rest as published.
    """
    for low, high, name, factor in ACCELERATION_UNITS:
        if low <= size < high:
            return f"it looks like {name} published as m/s²; multiply by {factor} in the driver"
    return ""


MISLED_BY_AXES = (
    Reason.FIELD_TOO_STEEP,
    Reason.AXIS_ALONG_FIELD,
    Reason.AXES_DISAGREE,
    Reason.NO_SOLUTION,
    Reason.AMBIGUOUS,
)
"""Refusals that axes which point down or sideways can be the cause of."""

LEAST_UPRIGHT = 0.5
"""Share of gravity on a body's z from which z counts as up: less than 60 degrees of lean."""


def explained(refusal: Refusal, window: Window) -> Refusal:
    """Add the field's likely unit, axes that point down, or stamps in bursts, to a refusal.

    Either upsets every check before it shows by itself.
    """
    if len(window) == 0:
        return refusal
    hint = likely_field_unit(float(np.median(np.linalg.norm(window.field, axis=1))))
    if not hint and refusal.reason in MISLED_BY_AXES:
        force = window.specific_force.mean(axis=0)
        hint = Z_NOT_UP if force[2] < LEAST_UPRIGHT * float(np.linalg.norm(force)) else ""
        hint = hint or bursts_of_a_turn(window.time)
    return Refusal(refusal.reason, f"{str(refusal).rstrip('.')}; {hint}") if hint else refusal
