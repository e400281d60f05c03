"""Limits, candidates, jobs for a worker process, and decisions of self-calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import PARAMETERS, Correction
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import (
    calibration_sigma,
    heading_swing,
    known_sigma,
)
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import Window

if TYPE_CHECKING:
    # A node starts without the smoother.
    from magcal_ros.core.smoother.drives import LikelihoodRatio


@dataclass(frozen=True)
class SelfCalibrationTuning:
    """Thresholds of self-calibration; seconds are of movement."""

    look_every: float = 20.0  # seconds between two jobs
    look_again: float = 10.0  # the same while a changed hard iron is on probation
    watch_every: float = 60.0  # the same if no calibration is sought
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
    """Least log likelihood ratio on the probation's data, roadside steel allowed; both halves must
    gain. It is lower for hard iron, whose change was clear before."""
    roadside: float = 0.01
    """Prior probability of steel on one side of all roads of one quarter of the headings."""
    usual_speed: float = 5.0  # m/s of a robot whose speed is not measured
    memory: float = 600.0  # seconds of driving that are kept
    map_every: float = 0.5  # seconds between points of the map of a drive


SELF_CALIBRATION = SelfCalibrationTuning()


METHOD = "smoother"


class CandidateKind(str, Enum):
    """The calibrations that are compared with the one in force."""

    EARLIER = "earlier"  # the one that was in force before
    ALL = "all"  # all twelve numbers, fitted to a part of a drive
    IRON = "iron"  # its hard iron alone, fitted to the drive since a change


@dataclass(frozen=True, eq=False)
class DriveCandidate:
    """A calibration that may replace the one in force; only data after its end can prove it."""

    kind: CandidateKind
    calibration: Calibration
    start: float
    end: float
    """Clock at the start and the end of the data of the fit, seconds. For an earlier calibration
    both are the clock at which it was replaced."""
    in_motion: Correction | None = None
    """Of the moving robot, with the mean field of its motors; None if no motors were fitted."""
    ratio: LikelihoodRatio | None = None
    """Over the watched calibration, on the data of the fit; None if the two hardly differ."""

    @property
    def sigma(self) -> float:
        """Sigma of the heading by the calibration, radians."""
        return known_sigma(self.calibration)

    @property
    def is_proved(self) -> bool:
        """Whether its own data prove that the watched calibration does not hold.

        Each number fitted to them raises their log likelihood by one more than that of other data
        (Akaike, IEEE Trans. Automatic Control 19, 1974).
        """
        if self.ratio is None:
            return False
        fitted = 3 if self.kind is CandidateKind.IRON else PARAMETERS
        return bool(reason_to_accept(self.kind, self.ratio, fitted))

    @property
    def sectors(self) -> int:
        """Number of headings driven, of twelve."""
        return round(self.calibration.evidence.figure(Figure.HEADINGS_DRIVEN, 0.0))

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
    """Return the RMS difference of two calibrations over headings, without a constant; radians."""
    return heading_swing(new.correction, old.correction, new.strength, new.inclination)


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
    calibration: Calibration | None = None  # the one to be put in force or offered, if any

    @property
    def is_change(self) -> bool:
        """Whether its calibration is to be put in force."""
        return self.calibration is not None and self.kind is not DecisionKind.PROPOSED


class Mode(str, Enum):
    """What is done with a proved candidate."""

    PROPOSE = "propose"
    APPLY = "apply"
    OFF = "off"


Contests = Mapping[CandidateKind, tuple[DriveCandidate, ...]]
"""The candidates that are compared with the calibration in force, each with all its fits, the
newest last. Each fit corrects the data after it; data count from the end of the first one."""


def is_same(one: Calibration | None, other: Calibration | None) -> bool:
    """Whether the twelve numbers are the same."""
    if one is None or other is None:
        return one is other
    return one.correction.is_same(other.correction)


def reason_to_accept(kind: CandidateKind, ratio: LikelihoodRatio, fitted: int = 0) -> str:
    """Return in words why a calibration is better than the one in force; empty if not proved.

    An earlier calibration was fitted to other data: steel that imitates it is most unlikely.
    `fitted` is how many numbers were fitted to the data of the ratio.
    """
    is_iron = kind is CandidateKind.IRON
    enough = SELF_CALIBRATION.iron_proof if is_iron else SELF_CALIBRATION.likelihood_proof
    gain = ratio.gain
    if kind is not CandidateKind.EARLIER:
        gain = ratio.gain_over_steel(SELF_CALIBRATION.roadside)
    if gain - fitted <= enough or min(ratio.halves) <= 0.0:
        return ""
    return (
        f"it predicts the {ratio.seconds:.0f} s of driving since then better, by "
        f"{ratio.gain:.0f} units of log likelihood and in both halves of the time"
    )


@dataclass(frozen=True, eq=False)
class DriveJob:
    """The input of a worker that examines a drive; it can be sent to another process."""

    log: Window  # the last minutes
    knowledge: Knowledge
    in_force: Calibration | None  # or the proposal, with which candidates are compared
    windows: tuple[float, ...]
    """Seconds of the newest driving to which all twelve numbers are fitted."""
    changed: float = -math.inf
    """Clock of the last proved change, seconds: no fit uses data from before it."""
    contests: Contests = field(default_factory=dict)
    watched: Calibration | None = None  # the one in force, also while another one is proposed


@dataclass(frozen=True, eq=False)
class DriveResult:
    """The results of a job."""

    clock: float  # of the newest data, seconds
    candidates: tuple[DriveCandidate, ...] = ()
    """Of all twelve numbers, and of the hard iron since the last proved change."""
    since_change: DriveCandidate | None = None  # the hard iron since a suspected change
    ratios: Mapping[CandidateKind, LikelihoodRatio] = field(default_factory=dict)
    """Of the contests, on the data that count."""
    refusal: str = ""  # why no fit of all twelve numbers was made; empty if one was made, or is due
