"""What may be done with a proved candidate, and what is still compared."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from magcal_ros.core.calibration.calibration import Calibration


class Mode(str, Enum):
    """What may be done with a proved candidate."""

    PROPOSE = "propose"
    APPLY = "apply"
    OFF = "off"


@dataclass(frozen=True, eq=False)
class Trial:
    """The calibration before the one in force, still compared with it.

    Parameters
    ----------
    calibration : Calibration
    since : float
        Clock from which road counts, seconds.
    """

    calibration: Calibration
    since: float


def is_same(one: Calibration | None, other: Calibration | None) -> bool:
    """Whether the numbers are the same object, whoever accepted them."""
    if one is None or other is None:
        return one is other
    return one.correction is other.correction
