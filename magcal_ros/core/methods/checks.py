"""What no method can work without."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.streams import STREAMS, SWAY
from magcal_ros.core.samples.window import Window

WEAKEST_FORCE = 0.8
"""m/s². Gravity in any unit that can be named is larger, one g published as m/s² the least."""

NO_UNIT_EXPLAINS = {"magnetometer": 1e7, "accelerometer": 1e7, "gyro": 1e6}
"""Tesla, m/s², rad/s. The Earth's field, gravity and every turn are far below, even in nanotesla,
micro-g and millidegrees published as these."""


def refuse_empty(window: Window, min_samples: int) -> None:
    """Refuse a window that says too little to begin with.

    Raises
    ------
    Refusal
        For numbers that no unit explains, too few samples, an accelerometer without gravity, or
        a field of zero.
    """
    _refuse_nonsense(window)
    if len(window) < min_samples:
        raise Refusal(
            Reason.TOO_FEW_SAMPLES,
            f"Only {len(window)} samples; at least {min_samples} are needed. Turn more "
            "slowly or check the rate of the topics.",
        )
    if _usual_size(window.specific_force) < WEAKEST_FORCE:
        raise Refusal(
            Reason.GRAVITY_ABSENT,
            "The accelerometer shows no gravity. It must publish specific force in m/s², +9.81 "
            "upwards at rest, with gravity not taken off.",
        )
    if _usual_size(window.field) < STREAMS.smallest_field:
        raise Refusal(
            Reason.FIELD_ABSENT, "The magnetometer reads zero. Check its driver and its topic."
        )


def too_slow(window: Window, knowledge: Knowledge) -> Refusal | None:
    """Return why samples come too slowly for any fit that believes their gyro; None if not."""
    if window.angular_rate is None or len(window) < 2 or knowledge.systematics.are_none:
        return None
    step = float(np.median(np.diff(window.time)))
    if step <= SWAY:
        return None
    return Refusal(
        Reason.TOO_SLOW,
        f"The samples of field and IMU come at {1.0 / step:.2g} Hz, and what the gyro measures "
        "does not say how the robot turned and swayed between them. Publish or record both at 10 "
        "Hz or more, or let the driver average its readings and turn more slowly.",
    )


def _usual_size(vectors: FloatArray) -> float:
    return float(np.median(np.linalg.norm(vectors, axis=1)))


def _refuse_nonsense(window: Window) -> None:
    """Refuse numbers so large that their squares and fourth powers would leave the floats."""
    rate = np.zeros(3) if window.angular_rate is None else window.angular_rate
    readings = (window.field, window.specific_force, rate)
    for (sensor, limit), values in zip(NO_UNIT_EXPLAINS.items(), readings, strict=True):
        largest = float(np.abs(values).max(initial=0.0))
        if largest > limit:
            raise Refusal(
                Reason.NOT_FINITE,
                f"The {sensor} reads up to {largest:.0e}, which no unit explains. "
                "Check its driver.",
            )
