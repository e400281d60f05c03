"""Self-calibration: its limits, its candidates, the jobs for a worker process, and decisions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.heading_sigma import (
    calibration_sigma,
    headings_apart,
    known_sigma,
)
from magcal_ros.core.geometry.attitude import mean_angle, wrap_angle
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class KeepingTuning:
    """Numbers of self-calibration; seconds are of movement."""

    look_every: float = 20.0  # seconds between two looks
    look_again: float = 10.0  # the same while a changed hard iron is on probation
    windows: tuple[float, ...] = (120.0, 200.0, 300.0, 420.0)
    """Seconds of road to which all twelve numbers are fitted."""
    look_back: float = 240.0
    shortest_since: float = 25.0
    """Seconds of road in which a change is looked for, and the least of the road since it to which
    the hard iron is fitted."""
    notice_differs: float = 4.0  # sigmas by which a changed hard iron must differ to be reported
    notice_proof: float = 2.0  # units of log likelihood by which the road must speak for it
    plainly: float = 0.2  # share of its difference that the sigma of a changed iron may reach
    largest_sigma: float = math.radians(3.0)  # radians beyond which no candidate is believed
    fewest_sectors: int = 6  # of twelve headings that all twelve numbers need
    fewest_for_iron: int = 4  # and that the hard iron alone needs
    differs: float = 2.0  # sigmas within which two calibrations agree: then nothing is to be mended
    much_better: float = 0.6
    """Share of the other's sigma below which it is taken up all the same. Where that is beyond
    `largest_sigma` and both agree, this is enough."""
    longest_probation: float = 180.0  # seconds of road after which an unproved candidate is dropped
    longest_trial: float = 300.0  # and after which the one before is no longer compared
    likelihood_proof: float = 12.0
    iron_proof: float = 8.0
    """Fall of minus log likelihood, independent units, on the road of probation, with a rise in
    neither half; less is asked of a hard iron, which was far off already to be noticed."""
    elsewhere_proof: float = 2.0
    """Units of it that must be left without the quarter of headings that speaks most, where all
    twelve numbers are new."""
    most_against: float = 1.5  # units that headings against a changed hard iron may have
    usual_speed: float = 5.0  # m/s of a robot whose speed is not measured
    memory: float = 600.0  # seconds of road that are remembered
    map_every: float = 0.5  # seconds between points of the map of a drive
    kept: int = 3  # calibrations that are kept from before the one in force
    remembered: int = 20  # decisions that are kept


KEEPING = KeepingTuning()


METHOD = "smoother"


class Kind(str, Enum):
    """What of a calibration was fitted."""

    ALL = "all"
    IRON = "iron"


@dataclass(frozen=True, eq=False)
class DriveCandidate:
    """A calibration that a stretch of road shows."""

    kind: Kind
    calibration: Calibration
    sigma: float  # radians of heading, as it says
    sectors: int  # of twelve headings driven
    start: float  # clock of the road that it was fitted to, seconds
    end: float  # and where that ends

    @property
    def seconds(self) -> float:
        """How much road it was fitted to."""
        return self.end - self.start

    @property
    def in_words(self) -> str:
        """What it is, for a person."""
        what = "calibration" if self.kind is Kind.ALL else "hard iron"
        return (
            f"a {what} from {self.seconds:.0f} s of driving, {self.sectors} of 12 headings,"
            f" ±{math.degrees(self.sigma):.1f}°"
        )


def is_another(candidate: DriveCandidate, in_force: Calibration) -> bool:
    """Whether a candidate differs from what is in force by more than both are uncertain."""
    apart = difference(in_force, candidate.calibration)
    return apart > KEEPING.differs * math.hypot(candidate.sigma, calibration_sigma(in_force))


def is_finer(candidate: DriveCandidate, in_force: Calibration) -> bool:
    """Whether a candidate agrees with what is in force, and is known much better."""
    is_better = candidate.sigma < KEEPING.much_better * known_sigma(in_force)
    return is_better and not is_another(candidate, in_force)


def difference(old: Calibration, new: Calibration) -> float:
    """Return the RMS over headings by which two calibrations differ, radians.

    The constant is taken off: no drive shows it.
    """
    apart = headings_apart(new.correction, old.correction, new.strength, new.inclination)
    return math.sqrt(float(np.mean(wrap_angle(apart - mean_angle(apart)) ** 2)))


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

    clock: float  # seconds of movement since the drive began
    verb: Verb
    words: str  # what and why, one sentence
    calibration: Calibration | None = None  # what is to be put in force, where something is


class Mode(str, Enum):
    """What may be done with a proved candidate."""

    PROPOSE = "propose"
    APPLY = "apply"
    OFF = "off"


class Probation(NamedTuple):
    """A candidate that has to prove itself, as it is known by now, and what it was at each look.

    Each step is for the road from there; road counts from the first one on.
    """

    candidate: DriveCandidate
    steps: tuple[Step, ...]

    @staticmethod
    def of(candidate: DriveCandidate, before: tuple[Step, ...] = ()) -> Probation:
        """Return the probation of a candidate that was something else at the steps before."""
        return Probation(candidate, (*before, Step(candidate.end, candidate.calibration)))


def is_same(one: Calibration | None, other: Calibration | None) -> bool:
    """Whether the twelve numbers are the same, whoever accepted them."""
    if one is None or other is None:
        return one is other
    return one.correction.is_same(other.correction)


@dataclass(frozen=True)
class Proof:
    """How well a new and an old calibration explain the road driven after the fit."""

    seconds: float = 0.0  # of road
    likelihood: float = 0.0  # fall of minus log likelihood on all of the road, independent units
    halves: tuple[float, float] = (0.0, 0.0)  # the same of its two halves
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
            f"it explains {self.seconds:.0f} s of road driven since then better: by "
            f"{self.likelihood:.0f} units of log likelihood, and in both halves"
        )


class Step(NamedTuple):
    """A calibration, and the clock from which road is read by it, seconds."""

    since: float
    calibration: Calibration


@dataclass(frozen=True, eq=False)
class DriveJob:
    """One look at a drive; all that a worker needs, and it can be sent to one."""

    log: Window  # the last minutes
    knowledge: Knowledge
    in_force: Calibration | None
    windows: tuple[float, ...]
    """Seconds of the newest road to which all twelve numbers are fitted."""
    not_before: float  # clock before which no window begins, seconds: something changed there
    changed: float  # clock of the change that it was fitted after; minus infinity without
    contests: dict[str, tuple[Step, ...]]
    """What is compared with what is in force, by names: steps, each for the road that it was not
    fitted to; what is before the first does not count."""


@dataclass(frozen=True, eq=False)
class Findings:
    """What came of a look."""

    clock: float  # of the newest road, seconds
    candidates: tuple[DriveCandidate, ...]
    since_change: DriveCandidate | None
    finer: DriveCandidate | None
    """The hard iron of all road since a change that is suspected, and since the one that was
    proved."""
    proofs: dict[str, Proof]  # by the contests' names
