"""What self-calibration may do, what it decided, and why, in words."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.keeping.candidates import DriveCandidate
from magcal_ros.core.keeping.jobs import Step


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
    """One decision."""

    clock: float
    """Seconds of movement since the drive began."""
    verb: Verb
    words: str
    """What and why, one sentence."""
    calibration: Calibration | None = None
    """What is to be put in force, where something is."""

    @property
    def changes(self) -> bool:
        """Whether another calibration is to be put in force, or offered."""
        return self.calibration is not None


class Mode(str, Enum):
    """What may be done with a proved candidate."""

    PROPOSE = "propose"
    APPLY = "apply"
    OFF = "off"


@dataclass(frozen=True, eq=False)
class Trial:
    """The calibration before the one in force, still compared with it."""

    calibration: Calibration
    since: float
    """Clock from which road counts, seconds."""


@dataclass(frozen=True, eq=False)
class Probation:
    """A candidate that has to prove itself."""

    candidate: DriveCandidate
    """As it is known by now."""
    steps: tuple[Step, ...]
    """What it was at each look, for the road from there."""

    @staticmethod
    def of(candidate: DriveCandidate, before: Probation | None = None) -> Probation:
        """Return the probation of a candidate, or of one that is known better by now."""
        step = Step(candidate.end, candidate.calibration.correction)
        return Probation(candidate, (*(before.steps if before else ()), step))

    @property
    def since(self) -> float:
        """Clock from which road counts, seconds."""
        return self.steps[0].since


def is_same(one: Calibration | None, other: Calibration | None) -> bool:
    """Whether the twelve numbers are the same, whoever accepted them."""
    if one is None or other is None:
        return one is other
    return one.correction.is_same(other.correction)
