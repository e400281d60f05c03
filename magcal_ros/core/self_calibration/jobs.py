"""Candidates, jobs for a worker process, decisions, and whether the calibration in force holds.

The fits to the last minutes are compared with the calibration, as `check` compares the fit of a
recording. Because many fits are made, a difference counts only if the data of the fit prove it:
neither the calibration nor roadside steel explains them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING

from magcal_ros.core.assessment.grading import Check, Grade
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import PARAMETERS, Correction
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import (
    calibration_sigma,
    heading_swing,
    known_sigma,
)
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import in_axes
from magcal_ros.core.knowledge import Knowledge, level_rotation
from magcal_ros.core.monitoring.change import CHANGE, checks_of_change, local_chance
from magcal_ros.core.samples.window import Window
from magcal_ros.core.self_calibration.self_calibration_tuning import SELF_CALIBRATION

if TYPE_CHECKING:
    # A node starts without the smoother.
    from magcal_ros.core.smoother.drives import LikelihoodRatio


METHOD = "smoother"
NOTHING_YET = "the robot has not driven with a gyro yet"
TOO_UNCERTAIN = "there was too little driving over different headings"
AGAIN = "calibrate again"
SUSPECTED = "the last minutes differ from it, but do not prove a change"


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
    """Over the calibration in force, on the data of the fit; None if the two hardly differ."""

    @property
    def sigma(self) -> float:
        """Sigma of the heading by the calibration, radians."""
        return known_sigma(self.calibration)

    @property
    def proof(self) -> str:
        """Why its own data prove that the calibration in force does not hold; empty if not."""
        if self.ratio is None:
            return ""
        beyond_iron = PARAMETERS - 3 if self.kind is CandidateKind.ALL else 0
        return reason_to_accept(self.kind, self.ratio, beyond_iron)

    @property
    def seconds(self) -> float:
        """Duration of the data."""
        return self.end - self.start

    @property
    def in_words(self) -> str:
        """The candidate in words."""
        what = "calibration" if self.kind is CandidateKind.ALL else "hard iron"
        sectors = self.calibration.evidence.figure(Figure.HEADINGS_DRIVEN, 0.0)
        return (
            f"a {what} from {self.seconds:.0f} s of driving, {sectors:.0f} of 12 headings,"
            f" ±{math.degrees(self.sigma):.1f}°"
        )


def is_another(
    candidate: DriveCandidate, in_force: Calibration, sigmas: float = CHANGE.chance
) -> bool:
    """Whether a candidate differs from the calibration in force by more than so many sigmas."""
    sigma = math.hypot(candidate.sigma, calibration_sigma(in_force))
    return difference(in_force, candidate.calibration) > sigmas * sigma


def is_finer(candidate: DriveCandidate, in_force: Calibration) -> bool:
    """Whether a candidate agrees with the calibration in force, and has a much smaller sigma."""
    is_better = candidate.sigma < SELF_CALIBRATION.much_better * known_sigma(in_force)
    return is_better and not is_another(candidate, in_force)


def difference(old: Calibration, new: Calibration) -> float:
    """Return the RMS difference of two calibrations over headings, without a constant; radians."""
    both = in_axes((new.correction, old.correction), level_rotation(new.upward))
    return heading_swing(*both, new.strength, new.inclination)


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


def is_same(one: Calibration | None, other: Calibration | None) -> bool:
    """Whether the twelve numbers are the same."""
    if one is None or other is None:
        return one is other
    return one.correction.is_same(other.correction)


def reason_to_accept(kind: CandidateKind, ratio: LikelihoodRatio, fitted: int = 0) -> str:
    """Return in words why a calibration is better than the one in force; empty if not proved.

    `fitted` numbers besides the hard iron were fitted to the data of the ratio. Each raises their
    log likelihood by one more than that of other data (Akaike, IEEE Trans. Automatic Control 19,
    1974).
    """
    local = SELF_CALIBRATION.local
    if kind is CandidateKind.EARLIER:
        # That a disturbance has the very effect of a calibration from other data is as rare again.
        local *= local
    if ratio.log_odds(local) - fitted <= SELF_CALIBRATION.proof:
        return ""
    return (
        f"it explains the {ratio.seconds:.0f} s of driving since then better, by "
        f"{ratio.gain:.0f} units of log likelihood, even if a part of it was disturbed"
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
    contests: Mapping[CandidateKind, DriveCandidate] = field(default_factory=dict)
    """The candidates that are compared with `in_force` on the data after their end."""
    watched: Calibration | None = None  # the one in force, also while another one is proposed

    @property
    def upward(self) -> FloatArray:
        """Unit vector to the top of the vehicle in the IMU's axes, shape (3,)."""
        return self.knowledge.upward


@dataclass(frozen=True, eq=False)
class DriveResult:
    """The results of a job."""

    clock: float  # of the newest data, seconds
    candidates: tuple[DriveCandidate, ...] = ()
    """Of all twelve numbers, and of the hard iron since the last proved change."""
    since_change: DriveCandidate | None = None  # the hard iron since a suspected change
    ratios: Mapping[CandidateKind, LikelihoodRatio] = field(default_factory=dict)
    """Of the candidates in `DriveJob.contests`, on the data after their end."""
    refusal: str = ""  # why no fit of all twelve numbers was made; empty if one was made, or is due


@dataclass(frozen=True)
class Watch:
    """What the last minutes of driving say about the calibration in force."""

    is_stale: bool = False  # whether the calibration no longer holds
    findings: tuple[Check, ...] = ()
    """The checks by which the state was last decided; empty if it could not yet be judged."""
    missing: str = NOTHING_YET  # the missing data; empty if the last minutes were judged
    since: float = -math.inf  # clock from which fits contradict it, seconds of movement
    contradicted_at: float = -math.inf  # clock of the end of the last fit that does
    clock: float = math.nan  # of the last fits, seconds of movement

    def after(self, found: DriveResult, old: Calibration) -> Watch:
        """Return the state after a job; `old` is in force since the beginning of its data."""
        change, clock = found.since_change, found.clock
        fits = [*found.candidates, *([] if change is None else [change])]
        # A fit of the hard iron alone comes last, as it shows no other change.
        fits.sort(key=lambda fit: (fit.kind is CandidateKind.IRON, fit.sigma))
        checks = {fit: tuple(checks_of(fit, old)) for fit in fits}
        differing = [fit for fit in fits if any(map(_contradicts, checks[fit]))]
        if any(fit.proof for fit in differing):
            since = self.since if self.is_stale else max(fit.start for fit in differing)
            return Watch(True, checks[differing[0]], "", since, clock, clock)
        for fit in fits:
            # Data from before a change dilute it.
            is_whole = fit.kind is CandidateKind.ALL and fit.start >= self.contradicted_at
            if is_whole and fit not in differing and checks[fit][0].is_judged:
                return Watch(findings=checks[fit], missing="", clock=clock)
        missing = SUSPECTED if differing else found.refusal or TOO_UNCERTAIN
        return replace(self, clock=clock, missing=missing)

    @property
    def summary(self) -> str:
        """One or two sentences."""
        if self.is_stale:
            against = [each for each in self.findings if _contradicts(each)]
            by_swing = [each for each in against if each.figure is Figure.HEADING_SWING]
            # A change that turns the headings usually changes strength and dip, too.
            causes = "; ".join(each.words for each in by_swing or against)
            minutes = max((self.clock - self.since) / 60.0, 1.0)
            since = f"for about {minutes:.0f} min of driving"
            return f"The calibration has not held {since}: {causes}; {AGAIN}."
        if not self.findings:
            return f"Not judged yet: {self.missing}."
        if self.missing:
            return f"The calibration held when it was last judged. Since then: {self.missing}."
        return "The calibration holds on the headings of the last minutes."


def contradicts(fit: DriveCandidate, old: Calibration) -> bool:
    """Whether a fit differs from the calibration in force by more than chance and tolerance."""
    return any(map(_contradicts, checks_of(fit, old)))


def checks_of(fit: DriveCandidate, old: Calibration) -> Iterator[Check]:
    """Yield the checks of the calibration in force by a fit: heading, strength and dip.

    A field that is there only at rest, or only in motion, is of a place or of motors: the smaller
    figure of the two counts. A fit of the hard iron alone does not show a change of place.
    """
    fit, old = in_axes((fit, old), level_rotation(fit.calibration.upward))
    new = fit.calibration
    chance = CHANGE.chance * math.hypot(fit.sigma, calibration_sigma(old))
    size = new.evidence.figure(Figure.LOCAL_FIELD, 0.0) / old.strength
    local = CHANGE.chance * local_chance(size, fit.seconds)
    place = new.strength, new.inclination
    fits = [each for each in (new.correction, fit.in_motion) if each is not None]
    found = [checks_of_change(old, each, place, chance, local) for each in fits]
    shown = 1 if fit.kind is CandidateKind.IRON else None
    for checks in list(zip(*found, strict=True))[:shown]:
        yield min(checks, key=lambda check: check.value or 0.0)


def _contradicts(finding: Check) -> bool:
    return finding.is_judged and finding.grade.rank >= Grade.WARN.rank
