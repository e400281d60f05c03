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
    if max(largest / LARGEST_FIELD, float(np.abs(window.specific_force).max()) / LARGEST_FORCE) > 1:
        raise Refusal(
            Reason.NOT_FINITE,
            "The samples hold numbers that no unit explains. Check the drivers of both sensors.",
        )
