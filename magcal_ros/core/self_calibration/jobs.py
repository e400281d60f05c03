"""Limits, candidates, jobs for a worker process, and decisions of self-calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.heading_sigma import (
    calibration_sigma,
    heading_differences,
    known_sigma,
)
from magcal_ros.core.geometry.attitude import mean_angle, wrap_angle
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class SelfCalibrationTuning:
    """Thresholds of self-calibration; seconds are of movement."""

    look_every: float = 20.0  # seconds between two jobs
    look_again: float = 10.0  # the same while a changed hard iron is on probation
    windows: tuple[float, ...] = (120.0, 200.0, 300.0, 420.0)
    """Seconds of driving to which all twelve numbers are fitted."""
    look_back: float = 240.0
    shortest_since: float = 25.0
    """Seconds of driving in which a change is searched, and the least after a change to which the
    hard iron is fitted."""
    notice_differs: float = 4.0  # sigmas by which a changed hard iron must differ to be reported
    notice_proof: float = 2.0  # least log likelihood ratio of a change
    plainly: float = 0.2  # largest ratio of a changed iron's sigma to its difference
    largest_sigma: float = math.radians(3.0)  # of a candidate, radians
    fewest_sectors: int = 6  # of twelve headings, for all twelve numbers
    fewest_for_iron: int = 4  # the same for the hard iron alone
    differs: float = 2.0  # sigmas within which two calibrations agree
    much_better: float = 0.6
    """Ratio of sigmas below which a candidate that agrees is still used. If the other sigma is
    above `largest_sigma`, this is enough without probation."""
    longest_probation: float = 180.0  # seconds after which an unproved candidate is dropped
    longest_trial: float = 300.0  # seconds for which the previous calibration is still compared
    likelihood_proof: float = 12.0
    iron_proof: float = 8.0
    """Least log likelihood ratio on the probation's data, positive in both halves. It is lower for
    hard iron, whose change was clear before."""
    elsewhere_proof: float = 2.0
    """Least of this ratio without the quarter of headings that contributes most, if all twelve
    numbers are new."""
    most_against: float = 1.5  # largest sum over the headings that contradict a changed hard iron
    usual_speed: float = 5.0  # m/s of a robot whose speed is not measured
    memory: float = 600.0  # seconds of driving that are kept
    map_every: float = 0.5  # seconds between points of the map of a drive
    kept: int = 3  # previous calibrations that are kept
    remembered: int = 20  # decisions that are kept


SELF_CALIBRATION = SelfCalibrationTuning()


METHOD = "smoother"


class CandidateKind(str, Enum):
    """Which numbers of a calibration were fitted."""

    ALL = "all"
    IRON = "iron"


@dataclass(frozen=True, eq=False)
class DriveCandidate:
    """A calibration fitted to a part of a drive."""

    kind: CandidateKind
    calibration: Calibration
    sigma: float  # of the heading, radians
    sectors: int  # of twelve headings driven
    start: float
    end: float
    """Clock at the start and the end of the data, seconds."""

    @property
    def seconds(self) -> float:
        """Duration of the data."""
        return self.end - self.start

    @property
    def in_words(self) -> str:
        """The candidate in words."""
        what = "calibration" if self.kind is CandidateKind.ALL else "hard iron"
        return (
            f"a {what} from {self.seconds:.0f} s of driving, {self.sectors} of 12 headings,"
            f" ±{math.degrees(self.sigma):.1f}°"
        )


def is_another(candidate: DriveCandidate, in_force: Calibration) -> bool:
    """Whether a candidate differs significantly from the calibration in force."""
    apart = difference(in_force, candidate.calibration)
    return apart > SELF_CALIBRATION.differs * math.hypot(
        candidate.sigma, calibration_sigma(in_force)
    )


def is_finer(candidate: DriveCandidate, in_force: Calibration) -> bool:
    """Whether a candidate agrees with the calibration in force, and has a much smaller sigma."""
    is_better = candidate.sigma < SELF_CALIBRATION.much_better * known_sigma(in_force)
    return is_better and not is_another(candidate, in_force)


def difference(old: Calibration, new: Calibration) -> float:
    """Return the RMS difference of two calibrations over headings, radians.

    The constant part is subtracted, because a drive cannot show it.
    """
    apart = heading_differences(new.correction, old.correction, new.strength, new.inclination)
    return math.sqrt(float(np.mean(wrap_angle(apart - mean_angle(apart)) ** 2)))


class DecisionKind(str, Enum):
    """The kinds of decision."""

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
    kind: DecisionKind
    words: str  # the decision with its reason, one sentence
    calibration: Calibration | None = None  # the one to be put in force, if any


class Mode(str, Enum):
    """What is done with a proved candidate."""

    PROPOSE = "propose"
    APPLY = "apply"
    OFF = "off"


class Probation(NamedTuple):
    """A candidate on probation: its newest fit, and its fits at each job.

    Each step corrects the data after it; data count from the first step on.
    """

    candidate: DriveCandidate
    steps: tuple[CalibrationStep, ...]

    @staticmethod
    def of(candidate: DriveCandidate, before: tuple[CalibrationStep, ...] = ()) -> Probation:
        """Return the probation of a candidate, with its fits before."""
        return Probation(
            candidate, (*before, CalibrationStep(candidate.end, candidate.calibration))
        )


def is_same(one: Calibration | None, other: Calibration | None) -> bool:
    """Whether the twelve numbers are the same."""
    if one is None or other is None:
        return one is other
    return one.correction.is_same(other.correction)


@dataclass(frozen=True)
class HeldOutComparison:
    """Comparison of a new and an old calibration on held-out data, driven after the fit."""

    seconds: float = 0.0  # of driving
    likelihood: float = 0.0  # log likelihood ratio on all data, weighted for correlation
    halves: tuple[float, float] = (0.0, 0.0)  # the same for both halves of the data
    without_best_quarter: float = 0.0
    """The ratio without the quarter of headings that favours the new calibration most: steel on
    one side of the path affects one quarter only."""
    opposing: float = 0.0
    """The sum over the headings that favour the old calibration. Added iron is visible at nearly
    all headings, steel on one side of the path at a few."""

    def reason_to_accept(self, kind: CandidateKind | None = None) -> str:
        """Return in words why the new calibration is better; empty if that is not proved."""
        enough = (
            SELF_CALIBRATION.iron_proof
            if kind is CandidateKind.IRON
            else SELF_CALIBRATION.likelihood_proof
        )
        is_elsewhere = (
            kind is not CandidateKind.ALL
            or self.without_best_quarter >= SELF_CALIBRATION.elsewhere_proof
        )
        is_unopposed = (
            kind is not CandidateKind.IRON or self.opposing <= SELF_CALIBRATION.most_against
        )
        is_clear = self.likelihood > enough and min(self.halves) > 0.0
        if not (is_clear and is_elsewhere and is_unopposed):
            return ""
        return (
            f"it predicts the {self.seconds:.0f} s of driving since then better, by "
            f"{self.likelihood:.0f} units of log likelihood and in both halves of the time"
        )


class CalibrationStep(NamedTuple):
    """A calibration, and the clock from which it corrects the data, seconds."""

    since: float
    calibration: Calibration


@dataclass(frozen=True, eq=False)
class DriveJob:
    """The input of a worker that examines a drive; it can be sent to another process."""

    log: Window  # the last minutes
    knowledge: Knowledge
    in_force: Calibration | None
    windows: tuple[float, ...]
    """Seconds of the newest driving to which all twelve numbers are fitted."""
    not_before: float  # clock of a change, before which no window begins, seconds
    changed: float  # clock of the last proved change, seconds; minus infinity without one
    contenders: dict[str, tuple[CalibrationStep, ...]]
    """Calibrations that are compared with the one in force, by name: steps, each for held-out data.
    Data before the first step do not count."""


@dataclass(frozen=True, eq=False)
class DriveResult:
    """The results of a job."""

    clock: float  # of the newest data, seconds
    candidates: tuple[DriveCandidate, ...]
    since_change: DriveCandidate | None
    finer: DriveCandidate | None
    """The hard iron since a suspected change, and since the last proved one."""
    comparisons: dict[str, HeldOutComparison]  # by the contests' names
