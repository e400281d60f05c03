"""Guessing the unit of numbers that cannot be what they claim to be."""

from __future__ import annotations

FIELD_UNITS: tuple[tuple[float, float, str, str], ...] = (
    (0.05, 5.0, "gauss", "1e-4"),
    (5.0, 150.0, "microtesla", "1e-6"),
    (150.0, 5000.0, "milligauss", "1e-7"),
    (5000.0, 500_000.0, "nanotesla", "1e-9"),
)
"""Size range of a field in the Earth's when published in another unit, its name, its factor."""


def likely_field_unit(size: float) -> str:
    """Say in words which unit a field of `size` "tesla" probably has; empty if none fits.

    Parameters
    ----------
    size : float
        Length of the field vector as published.
    """
    for low, high, name, factor in FIELD_UNITS:
        if low <= size < high:
            return (
                f"a field of {size:.3g} T looks like {name} published as tesla; "
                f"multiply by {factor} in the driver"
            )
    return ""


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
