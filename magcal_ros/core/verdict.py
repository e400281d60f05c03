"""How good and how certain a calibration is, in grades and in words.

Quality asks whether the samples agree with the model; confidence asks whether enough was seen.
The two never mix: a clean circle proves neither the heading nor the other way round.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.attitude import STANDARD_GRAVITY
from magcal_ros.core.errors import Refusal
from magcal_ros.core.estimate import Estimate
from magcal_ros.core.figures import common_figures, sideways_pull
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.thresholds import (
    DEGREES,
    EARTHS_FIELD_UT,
    GRAVITY_MISFITS,
    THRESHOLDS,
    Aspect,
    Check,
    Grade,
    Threshold,
)
from magcal_ros.core.units import likely_acceleration_unit, likely_field_unit
from magcal_ros.core.window import Window

__all__ = ["THRESHOLDS", "Aspect", "Check", "Grade", "Threshold", "Verdict", "judge", "refuse"]

REASONS_IN_SUMMARY = 2
SEVERAL = 2.0
"""Times the heading's sigma from which soft iron that was not shown is worth a word."""
CHANCE, CHANCE_WITH_SOFT_IRON = 3.0, 8.0
"""Heading sigmas of the whole turn by which its halves may differ; a half hardly shows iron."""
NEARLY_FULL = math.radians(300.0)
"""Arc from which a steady sideways pull can be told from a slope."""
ALLOWED_SIGMAS = 2.0
"""Of the reference field's own belief, which its radius may be off before it counts."""


@dataclass(frozen=True)
class Verdict:
    """The judgement on one estimate.

    Parameters
    ----------
    checks : tuple of Check
        Everything that was looked at.
    not_shown : tuple of str
        What this turn could not show.
    summary : str
        One sentence.
    """

    checks: tuple[Check, ...]
    not_shown: tuple[str, ...]
    summary: str

    @property
    def quality(self) -> Grade:
        """The worst grade among the checks of quality."""
        return self._worst(Aspect.QUALITY)

    @property
    def confidence(self) -> Grade:
        """The worst grade among the checks of confidence."""
        return self._worst(Aspect.CONFIDENCE)

    @property
    def accepted(self) -> bool:
        """Whether the calibration may be put in force without asking a person."""
        return Grade.REFUSED not in (self.quality, self.confidence)

    def _worst(self, aspect: Aspect) -> Grade:
        grades = [check.grade for check in self.checks if check.aspect is aspect]
        return max(grades, key=lambda grade: grade.rank, default=Grade.REFUSED)


NO_YAW = "the yaw of the installation: mount the sensor square, or compare with a known heading"
NO_MOUNTING = (
    "the mounting of the magnetometer against the IMU: this method took their axes for aligned and "
    "corrects nothing of it"
)
NO_GYRO = (
    "a distorted room, mirrored axes or a sideways pull while turning: gyro against compass was not"
    " checked, because there is no gyro"
)
NO_REFERENCE = "the size of the field: the reference field is not known"


def judge(estimate: Estimate, knowledge: Knowledge, window: Window | None = None) -> Verdict:
    """Weigh an estimate.

    Parameters
    ----------
    estimate : Estimate
        What a method found.
    knowledge : Knowledge
        What it was told beforehand.
    window : Window, optional
        The samples; without them gravity is not checked.

    Returns
    -------
    Verdict
    """
    figures = judged_figures(estimate, knowledge)
    if window is not None and window.angular_rate is not None and estimate.arc > NEARLY_FULL:
        figures["sideways_pull"] = sideways_pull(window)
    checks = [t.check(figures[t.figure]) for t in THRESHOLDS if t.figure in figures]
    checks.append(_check_strength(estimate.strength))
    if "gyro_carried" in figures:
        checks.append(_check_carrying(figures["gyro_carried"] > 0.0))
    if window is not None:
        checks.append(_check_gravity(window))
    not_shown = _not_shown(estimate, figures, knowledge)
    verdict = Verdict(tuple(checks), not_shown, "")
    return Verdict(tuple(checks), not_shown, _summary(verdict, estimate, figures))


def judged_figures(estimate: Estimate, knowledge: Knowledge) -> dict[str, float]:
    """Return every figure that the table can grade, by name; SI units."""
    figures = {
        "arc": estimate.arc,
        "samples": float(np.count_nonzero(estimate.inliers)),
        "axis_lean": math.acos(min(max(float(estimate.axis[2]), -1.0), 1.0)),
    }
    figures |= common_figures(estimate) | dict(estimate.figures)
    if "radius_misfit" in figures:
        allowed = ALLOWED_SIGMAS * _radius_sigma(knowledge)
        figures["radius_misfit"] = max(figures["radius_misfit"] - allowed, 0.0)
    if "split_half" in figures:
        # By chance halves differ by some sigmas of the whole, and these are graded by themselves.
        sigmas = CHANCE_WITH_SOFT_IRON if figures.get("soft_iron") else CHANCE
        chance = sigmas * figures["heading_sigma"]
        figures["split_half"] = math.sqrt(max(figures["split_half"] ** 2 - chance**2, 0.0))
    with_iron = figures.get("heading_sigma_soft_iron", 0.0)
    if with_iron > SEVERAL * figures["heading_sigma"]:
        figures["unseen_soft_iron"] = with_iron
    return figures


def _radius_sigma(knowledge: Knowledge) -> float:
    """Return how uncertain the reference's level field is, relative."""
    strength, dip = knowledge.reference.strength, knowledge.reference.inclination
    if strength.is_unknown or dip.is_unknown:
        return 0.0
    return math.hypot(
        strength.sigma / (abs(strength.value) or 1.0), math.tan(dip.value) * dip.sigma
    )


def refuse(refusal: Refusal) -> Verdict:
    """Turn a method's refusal into a verdict."""
    words = str(refusal)
    checks = tuple(Check(refusal.reason.value, aspect, Grade.REFUSED, words) for aspect in Aspect)
    return Verdict(checks, (), f"Refused: {words.rstrip('.')}.")


def _check_strength(strength: float) -> Check:
    microtesla = strength * 1e6
    low, high = EARTHS_FIELD_UT
    grade = Grade.EXCELLENT if low <= microtesla <= high else Grade.WARN
    words = f"field strength {microtesla:.1f} µT"
    if grade is Grade.WARN:
        hint = likely_field_unit(strength)
        words += f" is not the Earth's ({low:g} to {high:g} µT){': ' + hint if hint else ''}"
    return Check("strength", Aspect.QUALITY, grade, words)


def _check_carrying(carried: bool) -> Check:
    """Say whether the gyro's turning and the samples belong to one motion."""
    if carried:
        words = "the gyro's turning explains the samples"
        return Check("gyro_carried", Aspect.QUALITY, Grade.EXCELLENT, words)
    words = (
        "the gyro's turning does not explain the samples: check the axes and the stamps of the "
        "gyro, and keep the sensor near the turn's centre, away from iron"
    )
    return Check("gyro_carried", Aspect.QUALITY, Grade.WARN, words)


def _check_gravity(window: Window) -> Check:
    size = float(np.median(np.linalg.norm(window.specific_force, axis=1)))
    misfit = abs(size / STANDARD_GRAVITY - 1.0)
    excellent, good = GRAVITY_MISFITS
    grade = Grade.EXCELLENT if misfit <= excellent else Grade.GOOD
    words = f"acceleration at rest {size:.3g} m/s²"
    if not misfit <= good:
        grade = Grade.WARN
        hint = likely_acceleration_unit(size) or "check the accelerometer's range and scale"
        words += f" is not gravity's ({STANDARD_GRAVITY:.2f} m/s²): {hint}"
    return Check("gravity", Aspect.QUALITY, grade, words)


def _not_shown(
    estimate: Estimate, figures: Mapping[str, float], knowledge: Knowledge
) -> tuple[str, ...]:
    found = []
    if estimate.installation is None:
        found.append(NO_MOUNTING)
    elif "installation_yaw_sigma" not in figures:
        found.append(NO_YAW)
    level, tilted = figures["heading_sigma"], figures["heading_sigma_tilted"]
    if tilted > 2.0 * level and tilted * DEGREES > 0.5:
        found.append(
            "the hard iron along the turn's axis: fine on the level, but at 10° of tilt it costs "
            f"{tilted * DEGREES:.1f}° (1σ) of heading; give the reference field, or turn on ramps"
        )
    if "gyro_compass_rms" not in figures:
        found.append(NO_GYRO)
    if not knowledge.reference.is_complete:
        found.append(NO_REFERENCE)
    return tuple(found)


def _summary(verdict: Verdict, estimate: Estimate, figures: Mapping[str, float]) -> str:
    grades = f"quality {verdict.quality.value}, confidence {verdict.confidence.value}"
    if not verdict.accepted:
        return f"Refused ({grades}): {_reasons(verdict, Grade.REFUSED)}."
    x, y, z = (float(value) * 1e6 for value in estimate.correction.hard_iron)
    words = (
        f"{grades}: heading ±{figures['heading_sigma'] * DEGREES:.2f}° on the level, "
        f"±{figures['heading_sigma_tilted'] * DEGREES:.2f}° at 10° of tilt (1σ); "
        f"hard iron ({x:.1f}, {y:.1f}, {z:.1f}) µT"
    )
    if estimate.installation is not None:
        roll, pitch = estimate.installation.roll, estimate.installation.pitch
        words += f", installation roll {roll * DEGREES:.2f}°, pitch {pitch * DEGREES:.2f}°"
        if "installation_yaw_sigma" in figures:
            yaw, sigma = estimate.installation.yaw, figures["installation_yaw_sigma"]
            words += f", yaw {yaw * DEGREES:.2f}° ±{sigma * DEGREES:.2f}°"
    warnings = _reasons(verdict, Grade.WARN)
    return f"Calibrated, {words}.{' But ' + warnings + '.' if warnings else ''}"


def _reasons(verdict: Verdict, grade: Grade) -> str:
    """Return the first reasons for a grade: the table holds the weightiest first."""
    words = [check.words for check in verdict.checks if check.grade is grade]
    more = len(words) - REASONS_IN_SUMMARY
    return "; ".join(words[:REASONS_IN_SUMMARY]) + (f"; and {more} more" if more > 0 else "")
