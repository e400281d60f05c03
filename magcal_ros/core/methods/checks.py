"""What no method can work without."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.attitude import STANDARD_GRAVITY
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.window import Window


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
    if not window.field.any():
        raise Refusal(
            Reason.FIELD_ABSENT, "The magnetometer reads zero. Check its driver and its topic."
        )
