"""Whether the calibration in force holds while the robot drives.

The fits to the last minutes are compared with the calibration, as `check` compares the fit of a
recording. Because many fits are made, a difference counts only if the data of the fit prove it:
neither the calibration nor roadside steel explains them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from magcal_ros.core.assessment.grading import Check, Grade
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import calibration_sigma
from magcal_ros.core.monitoring.change import (
    CHANGE,
    check_place,
    compared,
    local_chance,
)
from magcal_ros.core.self_calibration.jobs import (
    CandidateKind,
    DriveCandidate,
    DriveResult,
)

NOTHING_YET = "the robot has not driven with a gyro yet"
TOO_UNCERTAIN = "there was too little driving over different headings"
AGAIN = "calibrate again"
SUSPECTED = "the last minutes differ from it, but do not prove a change"


@dataclass(frozen=True)
class Watch:
    """What the last minutes of driving say about the calibration in force."""

    is_stale: bool = False  # whether the calibration no longer holds
    was_judged: bool = False  # whether it could be judged at all since it is in force
    findings: tuple[Check, ...] = ()  # the checks by which the state was last decided
    missing: str = NOTHING_YET  # the missing data; empty if the last minutes were judged
    since: float = -math.inf  # clock from which fits contradict it, seconds of movement
    contradicted_at: float = -math.inf  # clock of the end of the last fit that does
    clock: float = math.nan  # of the last fits, seconds of movement

    def after(self, found: DriveResult, old: Calibration) -> Watch:
        """Return the state after a job; `old` is in force since the beginning of its data."""
        change, clock = found.since_change, found.clock
        fits = [*found.candidates, *(() if change is None else (change,))]
        judged = [(fit, tuple(checks_of(fit, old))) for fit in fits]
        differing = [(fit, checks) for fit, checks in judged if any(map(_contradicts, checks))]
        if any(fit.is_proved for fit, _ in differing):
            _, findings = min(differing, key=_rank)
            since = self.since if self.is_stale else max(fit.start for fit, _ in differing)
            return Watch(True, True, findings, "", since, contradicted_at=clock, clock=clock)
        # Data from before a change dilute it.
        agreeing = [
            (fit, checks)
            for fit, checks in judged
            if (fit, checks) not in differing
            and fit.kind is CandidateKind.ALL
            and fit.start >= self.contradicted_at
            and checks[0].is_judged
        ]
        if agreeing:
            _, findings = min(agreeing, key=_rank)
            return Watch(was_judged=True, findings=findings, missing="", clock=clock)
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
        if not self.was_judged:
            return f"Not judged yet: {self.missing}."
        if self.missing:
            return f"The calibration held when it was last judged; now {self.missing}."
        return "The calibration holds on the headings of the last minutes."


def _rank(each: tuple[DriveCandidate, tuple[Check, ...]]) -> tuple[bool, float]:
    """Return the order of fits: one of the hard iron alone shows no other change."""
    return each[0].kind is CandidateKind.IRON, each[0].sigma


def contradicts(fit: DriveCandidate, old: Calibration) -> bool:
    """Whether a fit differs from the calibration in force by more than chance and tolerance."""
    return any(map(_contradicts, checks_of(fit, old)))


def checks_of(fit: DriveCandidate, old: Calibration) -> Iterator[Check]:
    """Yield the checks of the calibration in force by a fit: heading, strength and dip.

    A field that is there only at rest, or only in motion, is of a place or of motors: the smaller
    figure of the two counts. A fit of the hard iron alone does not show a change of place.
    """
    new = fit.calibration
    chance = CHANGE.chance * math.hypot(fit.sigma, calibration_sigma(old))
    size = new.evidence.figure(Figure.LOCAL_FIELD, 0.0) / old.strength
    local = CHANGE.chance * local_chance(size, fit.seconds)
    found = [_of(new.correction, new, old, chance, local)]
    if fit.in_motion is not None:
        found.append(_of(fit.in_motion, new, old, chance, local))
    shown = 1 if fit.kind is CandidateKind.IRON else None
    for each in list(zip(*found, strict=True))[:shown]:
        yield min(each, key=lambda check: check.value or 0.0)


def _of(
    correction: Correction, new: Calibration, old: Calibration, chance: float, local: float
) -> tuple[Check, ...]:
    """Return the checks by a correction in the place of the new calibration."""
    place = new.strength, new.inclination
    return (
        compared(old.correction, correction, *place, chance),
        *check_place(old, correction, *place, local),
    )


def _contradicts(finding: Check) -> bool:
    return finding.is_judged and finding.grade.rank >= Grade.WARN.rank
