"""Whether a calibration still holds, by a new turn or drive.

The smoother is fitted to the field that the calibration has corrected. If nothing has changed, the
result is the identity. Otherwise it shows by how much the calibration turns the headings, whatever
the cause, and its covariance shows how certain this is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.assessment.bounds import AMOUNT
from magcal_ros.core.assessment.grading import Aspect, Bound, Check, Grade
from magcal_ros.core.assessment.verdict import LEVEL_ONLY, NO_REFERENCE, TUNING, Verdict
from magcal_ros.core.calibration.calibration import Calibration, Estimate, GyroSwing
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import (
    CHECKED_TILT,
    calibration_sigma,
    heading_swing,
)
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import level_part, unit, yaw_from_up_and_field
from magcal_ros.core.knowledge import (
    INCLINATION_SIGMA_DEG,
    STRENGTH_SIGMA_UT,
    Belief,
    Knowledge,
    ReferenceField,
    in_level_axes,
)
from magcal_ros.core.methods import smoother
from magcal_ros.core.monitoring.change import (
    CHANGE,
    DIP_BOUND,
    OTHER_ROBOT,
    STRENGTH_BOUND,
    SWING_BOUND,
    checks_of_change,
    local_chance,
)
from magcal_ros.core.samples.coverage import Coverage
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.kinds_of_motion import Smoothed
from magcal_ros.core.smoother.unknowns import DRIVES, MICROTESLA
from magcal_ros.core.up.follower import propagated_up

STATES = {
    Grade.EXCELLENT: "holds",
    Grade.GOOD: "holds",
    Grade.WARN: "doubtful",
    Grade.REFUSED: "stale",
}
"""The state of a calibration in force by its grade."""

SENTENCES = {
    "holds": "The calibration holds",
    "doubtful": "The calibration is doubtful",
    "stale": "The calibration is stale, calibrate again",
}

NO_GYRO = "whether the compass turns as the robot does: there is no gyro"
LOST_GYRO = (
    "whether the compass turns as the robot does: the field samples are more than "
    f"{STREAMS.longest_field_gap:g} s apart, too far to follow the gyro between them"
)
ON_A_DRIVE = (
    "whether iron nearby turns the compass: the samples look like a drive, along which the field "
    "differs from place to place"
)
NO_YAW = "an error of the yaw that is the same at every heading"
DISTORTED = "iron nearby or the motors change the field; turn once, in one place away from iron"
GYRO = Bound(
    Figure.GYRO_COMPASS_DIFFERENCE,
    (None, 4.0, 7.0),
    "gyro against compass, apart from this swing",
    DISTORTED,
)
ARC_BOUND = AMOUNT(
    Figure.ARC,
    (None, 270.0, 0.0),
    "the turn covers",
    "the headings that were not seen are not checked",
    unit="°",
)
RECHECK_BOUNDS = SWING_BOUND, GYRO, STRENGTH_BOUND, DIP_BOUND, ARC_BOUND
"""There is no grade above good: a recheck can only confirm a calibration."""


@dataclass(frozen=True, eq=False)
class Recheck:
    """The result of a recheck."""

    verdict: Verdict
    """Quality is whether the calibration holds, confidence how much of it was tested."""
    estimate: Estimate  # the old calibration with the residuals of the new samples, for a report
    sentence: str = ""  # the state in words, and where it holds

    @property
    def findings(self) -> tuple[Check, ...]:
        """The checks of whether the calibration holds."""
        return tuple(c for c in self.verdict.checks if c.aspect is Aspect.QUALITY)

    @property
    def is_judged(self) -> bool:
        """Whether any of the checks is conclusive."""
        return any(finding.is_judged for finding in self.findings)

    @property
    def state(self) -> str:
        """One of `STATES`."""
        return STATES[self.verdict.quality]


@in_level_axes
def check(window: Window, calibration: Calibration, drive: Window | None = None) -> Recheck:
    """Test a calibration by a new turn or drive.

    `drive` is the log of the same recording; it is used if the speed of wheels was measured.
    Raises `Refusal` if the samples do not determine what has changed.
    """
    samples = window if drive is None or not drive.rolls else drive
    is_lost = window.angular_rate is not None and bool(
        np.median(np.diff(samples.time)) > STREAMS.longest_field_gap
    )
    samples = replace(samples, angular_rate=None) if is_lost else samples
    unseen, swing = [NO_YAW], None
    if samples.angular_rate is None:
        unseen.append(LOST_GYRO if is_lost else NO_GYRO)
    try:
        found, estimate = _fit_of_corrected(samples, calibration)
    except Refusal as refusal:
        if refusal.reason is not Reason.AXES_DISAGREE:
            raise
        words = f"no change of the calibration explains the samples: {refusal}; {OTHER_ROBOT}"
        checks = [Check(refusal.reason, Aspect.QUALITY, Grade.REFUSED, words)]
    else:
        checks, swing = _checks(found, estimate, calibration)
        unseen += [ON_A_DRIVE] if found.mode in DRIVES else []
    up = propagated_up(window)
    heading = yaw_from_up_and_field(up, calibration.correction.apply(window.field))
    arc = Coverage.of(heading).arc
    slopes = _slopes_of(calibration)
    unseen += [slopes] if slopes else []
    verdict = Verdict((*checks, ARC_BOUND.check(arc)), tuple(unseen))
    on_samples = _on_fresh_samples(calibration, window, up, arc, swing)
    state = STATES[verdict.quality]
    sentence = SENTENCES[state] + (" on level ground" if slopes and state == "holds" else "")
    says = _summary(verdict, sentence)
    return Recheck(replace(verdict, says=says), on_samples, sentence)


def _fit_of_corrected(samples: Window, calibration: Calibration) -> tuple[Smoothed, Estimate]:
    """Return the fit of the corrected field."""
    correction = calibration.correction
    corrected = replace(
        samples,
        field=correction.apply(samples.field),
        rests=tuple(replace(r, field=correction.apply(r.field)) for r in samples.rests),
    )
    reference = ReferenceField(
        Belief(calibration.strength, STRENGTH_SIGMA_UT * 1e-6),
        Belief(calibration.inclination, math.radians(INCLINATION_SIGMA_DEG)),
    )
    known = Knowledge(reference)
    found = smoother.smoothed(corrected, known)
    estimate = smoother.estimate_of(found, corrected, known)
    smoother.check(found, estimate, corrected, known)
    return found, estimate


def _checks(
    found: Smoothed, estimate: Estimate, calibration: Calibration
) -> tuple[list[Check], GyroSwing | None]:
    """Return the checks by a fit of the corrected field, and the swing of compass minus gyro."""
    old, is_fixed = calibration.correction, found.mode not in DRIVES
    new, place = estimate.correction.after(old), (estimate.strength, estimate.inclination)
    corrected = found.nodes.field / MICROTESLA
    raw = old.undo(corrected)
    by_old, by_none = (heading_swing(new, each, *place) for each in (old, Correction.identity()))
    chance = CHANGE.chance * calibration_sigma(estimate)
    if is_fixed:
        # In an undisturbed place, the strength of a rightly corrected field is constant. Elsewhere
        # its standard deviation is about that of one component of the local disturbance.
        strength = np.linalg.norm(estimate.correction.apply(corrected), axis=1)
        chance = math.hypot(chance, float(np.std(strength)) / estimate.circle_radius)
    size = found.fit.local_field / MICROTESLA / calibration.strength
    local = CHANGE.chance * local_chance(size, float(np.ptp(found.nodes.time)))
    turned, *other = checks_of_change(calibration, new, place, chance, local, by_none)
    if estimate.swing is None:
        return [turned, *other], None
    swing = smoother.swing_of(found, corrected)
    left = math.sqrt(max(swing.rms**2 - by_old**2, 0.0))
    before = smoother.swing_of(found, raw).rms
    gyro = GYRO.check(left, excess=left if is_fixed else 0.0, before=before)
    if gyro.grade.rank >= Grade.WARN.rank:
        # It makes a place unsuitable for a check. On a drive, places differ, and it is not graded.
        gyro = replace(gyro, grade=Grade.WARN, is_judged=False)
    return [turned, gyro, *other], swing


def _slopes_of(calibration: Calibration) -> str:
    """Return why a calibration's file does not show the heading on slopes; empty if it does."""
    unseen = calibration.evidence.not_shown
    level, tilted = calibration_sigma(calibration), calibration_sigma(calibration, CHECKED_TILT)
    least, times = TUNING.costly
    is_costly = tilted > max(times * level, least)
    if NO_REFERENCE not in unseen or not (is_costly or LEVEL_ONLY in unseen):
        return ""
    error = f"±{math.degrees(tilted):.1f}°{'' if is_costly else ' or more'} (1σ) at 10° of tilt"
    return (
        "the heading on slopes: the calibration was made without a position, so its hard iron "
        f"along the vertical axis is uncertain, and the heading error is {error}; give the "
        "position when you calibrate again, or turn on ramps"
    )


def _summary(verdict: Verdict, sentence: str) -> str:
    """Return the sentence on the state, and the findings against the calibration."""
    state = STATES[verdict.quality]
    if state == "holds":
        return f"{sentence}."
    causes = (c for c in verdict.checks if c.aspect is Aspect.QUALITY)
    words = "; ".join(c.words for c in causes if STATES[c.grade] == state)
    return f"{sentence}: {words}."


def _on_fresh_samples(
    calibration: Calibration, window: Window, up: FloatArray, arc: float, swing: GyroSwing | None
) -> Estimate:
    """Return the old calibration with the residuals of the new samples."""
    correction = calibration.correction
    field = correction.apply(window.field)
    misfit = field - expected_field(field, up, calibration.strength, calibration.inclination)
    return Estimate(
        method=calibration.evidence.method,
        correction=correction,
        covariance=calibration.covariance,
        installation=None,
        axis=unit(up.mean(axis=0)),
        arc=arc,
        strength=calibration.strength,
        inclination=calibration.inclination,
        noise_field=calibration.noise_field,
        noise_up=calibration.noise_up,
        inliers=np.ones(len(window), dtype=np.bool_),
        residual=np.asarray(np.linalg.solve(correction.matrix, misfit.T).T, dtype=np.float64),
        message="checked with other samples than those it was made from",
        swing=swing,
    )


def expected_field(
    field: FloatArray, up: FloatArray, strength: float, inclination: float
) -> FloatArray:
    """Return the field (n, 3) of given strength and inclination at the heading of `field`."""
    level = unit(level_part(field, up))
    return np.asarray(strength * (math.cos(inclination) * level - math.sin(inclination) * up))
