"""What no method can work without."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.attitude import STANDARD_GRAVITY
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.streams import SMALLEST_FIELD
from magcal_ros.core.window import Window

LARGEST_FIELD = 1e7
"""Tesla. The Earth's field is far below, even in nanotesla published as tesla."""

LARGEST_FORCE = 1e7
"""m/s². Gravity is far below, even in micro-g published as m/s²."""

LARGEST_RATE = 1e6
"""rad/s. Every turn is far below, even in millidegrees published as radians."""


def refuse_empty(window: Window, min_samples: int) -> None:
    """Refuse a window that says too little to begin with.

    Parameters
    ----------
    window : Window
        The samples.
    min_samples : int
        Fewer are refused.

    Raises
    ------
    Refusal
        For too few samples, a field of zero, or an accelerometer without gravity.
    """
    if len(window) < min_samples:
        raise Refusal(
            Reason.TOO_FEW_SAMPLES,
            f"Only {len(window)} samples; at least {min_samples} are needed. Turn more "
            "slowly or check the rate of the topics.",
        )
    if float(np.median(np.linalg.norm(window.specific_force, axis=1))) < 0.5 * STANDARD_GRAVITY:
        raise Refusal(
            Reason.GRAVITY_ABSENT,
            "The accelerometer shows less than half of gravity. It must publish specific force "
            "in m/s², +9.81 upwards at rest, with gravity not taken off.",
        )
    largest = float(np.abs(window.field).max())
    if largest < SMALLEST_FIELD:
        raise Refusal(
            Reason.FIELD_ABSENT, "The magnetometer reads zero. Check its driver and its topic."
        )
    refuse_nonsense(window)


def refuse_nonsense(window: Window) -> None:
    """Refuse numbers so large that their squares and fourth powers would leave the floats.

    Raises
    ------
    Refusal
        With the sensor's name.
    """
    rate = np.zeros(3) if window.angular_rate is None else window.angular_rate
    for sensor, values, limit in (
        ("magnetometer", window.field, LARGEST_FIELD),
        ("accelerometer", window.specific_force, LARGEST_FORCE),
        ("gyro", rate, LARGEST_RATE),
    ):
        largest = float(np.abs(values).max(initial=0.0))
        if largest > limit:
            raise Refusal(
                Reason.NOT_FINITE,
                f"The {sensor} reads up to {largest:.0e}, which no unit explains. "
                "Check its driver.",
            )
