"""The jobs that self-calibration gives to a worker process, their results, and what is decided."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.keeping.candidates import KEEPING, DriveCandidate, Kind
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.drive_log import DriveLog


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


class Trial(NamedTuple):
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


@dataclass(frozen=True)
class Proof:
    """What the road after a fit says of a new calibration against an old one."""

    seconds: float = 0.0
    """Of road."""
    likelihood: float = 0.0
    """Fall of minus log likelihood on all of the road, independent units."""
    halves: tuple[float, float] = (0.0, 0.0)
    """The same of its two halves."""
    elsewhere: float = 0.0
    """What of it is left without the quarter of headings that speaks most for the new one: steel on
    one side of the way speaks in one alone."""
    against: float = 0.0
    """What the headings that speak against the new one say together: iron that came is seen at
    nearly all, steel on one side of the way at a few."""

    def stands(self, kind: Kind | None = None) -> str:
        """Return in words by what the new one is proved better; empty if it is not."""
        enough = KEEPING.iron_proof if kind is Kind.IRON else KEEPING.likelihood_proof
        is_elsewhere = kind is not Kind.ALL or self.elsewhere >= KEEPING.elsewhere_proof
        is_unopposed = kind is not Kind.IRON or self.against <= KEEPING.most_against
        is_clear = self.likelihood > enough and min(self.halves) > 0.0
        if not (is_clear and is_elsewhere and is_unopposed):
            return ""
        return (
            f"it explains {self.seconds:.0f} s of road driven since better, by"
            f" {self.likelihood:.0f} units of log likelihood and in both halves"
        )


class Step(NamedTuple):
    """A correction, and the clock from which road is read by it, seconds."""

    since: float
    correction: Correction


@dataclass(frozen=True, eq=False)
class Contest:
    """Two calibrations to be compared on road."""

    name: str
    """Whose it is, to tell the answers apart."""
    old: Correction
    new: tuple[Step, ...]
    """One after another, each for the road that it was not fitted to; what is before the first does
    not count."""


@dataclass(frozen=True, eq=False)
class DriveJob:
    """One look at a drive; all that a worker needs, and it can be sent to one."""

    log: DriveLog
    """The last minutes."""
    knowledge: Knowledge
    in_force: Calibration | None
    windows: tuple[float, ...]
    """Seconds of the newest road to which all twelve numbers are fitted."""
    not_before: float
    """Clock before which no window begins, seconds: something changed there."""
    changed: float
    """Clock of the change after which what is in force was fitted; minus infinity without one."""
    contests: tuple[Contest, ...]


@dataclass(frozen=True, eq=False)
class Findings:
    """What came of a look."""

    clock: float
    """Of the newest road, seconds."""
    candidates: tuple[DriveCandidate, ...]
    since_change: DriveCandidate | None
    finer: DriveCandidate | None
    """The hard iron of all road since a change that is suspected, and since the one that was
    proved."""
    proofs: dict[str, Proof]
    """By the contests' names."""
