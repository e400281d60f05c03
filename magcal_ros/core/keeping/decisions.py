"""What self-calibration decided, and why, in words."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from magcal_ros.core.calibration.calibration import Calibration


class Verb(str, Enum):
    """What was decided."""

    NOTICED = "noticed"
    PROBATION = "probation"
    DROPPED = "dropped"
    PROPOSED = "proposed"
    APPLIED = "applied"
    ROLLED_BACK = "rolled_back"
    CONFIRMED = "confirmed"
    REFINED = "refined"


@dataclass(frozen=True, eq=False)
class Decision:
    """One decision.

    Parameters
    ----------
    clock : float
        Seconds of movement since the drive began.
    verb : Verb
    words : str
        What and why, one sentence.
    calibration : Calibration or None
        What is to be put in force, where something is.
    """

    clock: float
    verb: Verb
    words: str
    calibration: Calibration | None = None

    @property
    def changes(self) -> bool:
        """Whether another calibration is to be put in force, or offered."""
        return self.calibration is not None
