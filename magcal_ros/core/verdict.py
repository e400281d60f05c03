"""How good and how certain a calibration is, in grades and in words.

Quality asks whether the samples agree with the model; confidence asks whether enough was seen.
The two never mix: a clean circle proves neither the heading nor the other way round.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from magcal_ros.core.errors import Refusal
from magcal_ros.core.estimate import Estimate
from magcal_ros.core.figures import common_figures
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.units import likely_field_unit


class Grade(str, Enum):
    """From best to worst; a refused calibration is not put in force by itself."""

    EXCELLENT = "excellent"
    GOOD = "good"
    WARN = "warn"
    REFUSED = "refused"

    @property
    def rank(self) -> int:
        """Zero for the best."""
        return list(Grade).index(self)


class Aspect(str, Enum):
    """Which of the two grades a check speaks to."""

    QUALITY = "quality"
    CONFIDENCE = "confidence"


@dataclass(frozen=True)
class Threshold:
    """The upper bounds of three grades for one figure.

    Parameters
    ----------
    figure : str
        Name in `Estimate.figures`.
    aspect : Aspect
        Quality or confidence.
    excellent, good, warn : float
        Largest values of these grades, in the unit people see; beyond `warn` it is refused.
    unit : str
        Unit people see: "°", "%", "σ", "" ...
    scale : float
        Figure (SI) times this gives the unit people see.
    words : str
        What the figure is.
    remedy : str
        What to do when it falls short.
    """

    figure: str
    aspect: Aspect
    excellent: float
    good: float
    warn: float
    unit: str
    scale: float
    words: str
    remedy: str

    def check(self, figure: float) -> Check:
        """Grade one value of the figure."""
        value = figure * self.scale
        bounds = ((Grade.EXCELLENT, self.excellent), (Grade.GOOD, self.good))
        grade = next((g for g, bound in bounds if value <= bound), Grade.WARN)
        if not value <= self.warn:
            grade = Grade.REFUSED
        words = f"{self.words} {value:.3g}{self.unit}"
        if grade.rank >= Grade.WARN.rank:
            limit = self.good if grade is Grade.WARN else self.warn
            words += f" (want {limit:g}{self.unit} or less): {self.remedy}"
        return Check(self.figure, self.aspect, grade, words)


@dataclass(frozen=True)
class Check:
    """One figure, graded and put into words."""

    figure: str
    aspect: Aspect
    grade: Grade
    words: str


DEGREES = 180.0 / math.pi
PERCENT = 100.0

THRESHOLDS: tuple[Threshold, ...] = (
    Threshold(
        "heading_sigma",
        Aspect.CONFIDENCE,
        0.3,
        0.5,
        2.0,
        "°",
        DEGREES,
        "predicted heading error on the level (1σ)",
        "turn a full circle, more slowly, and give the reference field",
    ),
    Threshold(
        "residual_ratio",
        Aspect.QUALITY,
        3.0,
        6.0,
        12.0,
        "%",
        PERCENT,
        "residual against the level field",
        "move away from steel and motors, and keep loads still while turning",
    ),
    Threshold(
        "outlier_share",
        Aspect.QUALITY,
        5.0,
        15.0,
        50.0,
        "%",
        PERCENT,
        "samples that were not believed",
        "something magnetic passed by or switched; turn again elsewhere",
    ),
    Threshold(
        "radius_misfit",
        Aspect.QUALITY,
        3.0,
        10.0,
        25.0,
        "%",
        PERCENT,
        "circle radius against the reference field",
        "check reference.strength_ut and inclination_deg, or look for soft iron and steel near by",
    ),
    Threshold(
        "ellipse_excess",
        Aspect.QUALITY,
        2.0,
        10.0,
        30.0,
        "%",
        PERCENT,
        "ellipse in the turn's plane, longer axis over shorter less one",
        "give soft_iron_gains, or move the magnetometer away from iron parts",
    ),
    Threshold(
        "split_half",
        Aspect.CONFIDENCE,
        0.3,
        0.7,
        4.0,
        "°",
        DEGREES,
        "headings from the two halves of the turn differ by",
        "turn once more, evenly, away from moving iron",
    ),
    Threshold(
        "gyro_compass_rms",
        Aspect.QUALITY,
        2.0,
        4.0,
        10.0,
        "°",
        DEGREES,
        "gyro against compass around the turn",
        "the field is distorted here, or the sensors' axes do not belong together; turn elsewhere",
    ),
    Threshold(
        "strength_pull",
        Aspect.QUALITY,
        1.0,
        2.0,
        4.0,
        "σ",
        1.0,
        "field strength pulled from the reference by",
        "check reference.strength_ut, or turn where the field is undisturbed",
    ),
    Threshold(
        "inclination_pull",
        Aspect.QUALITY,
        1.0,
        2.0,
        4.0,
        "σ",
        1.0,
        "inclination pulled from the reference by",
        "check reference.inclination_deg, or turn where the field is undisturbed",
    ),
    Threshold(
        "installation_angle",
        Aspect.QUALITY,
        5.0,
        15.0,
        45.0,
        "°",
        DEGREES,
        "installation error",
        "give the sensor's nominal pose with mount_rpy_deg",
    ),
)
"""The one table of bounds; they come from simulation and about ten recordings, so move them."""


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
NO_GYRO = "a distorted field: gyro against compass was not checked"
NO_REFERENCE = "the circle's radius was not checked: the reference field is not known"


def judge(estimate: Estimate, knowledge: Knowledge) -> Verdict:
    """Weigh an estimate.

    Parameters
    ----------
    estimate : Estimate
        What a method found.
    knowledge : Knowledge
        What it was told beforehand.

    Returns
    -------
    Verdict
    """
    figures = common_figures(estimate) | dict(estimate.figures)
    checks = [t.check(figures[t.figure]) for t in THRESHOLDS if t.figure in figures]
    checks.append(_check_strength(estimate.strength))
    not_shown = _not_shown(figures, knowledge)
    verdict = Verdict(tuple(checks), not_shown, "")
    return Verdict(tuple(checks), not_shown, _summary(verdict, estimate, figures))


def refuse(refusal: Refusal) -> Verdict:
    """Turn a method's refusal into a verdict."""
    words = str(refusal)
    checks = tuple(Check(refusal.reason.value, aspect, Grade.REFUSED, words) for aspect in Aspect)
    return Verdict(checks, (), f"Refused: {words.rstrip('.')}.")


def _check_strength(strength: float) -> Check:
    microtesla = strength * 1e6
    grade = Grade.EXCELLENT if 20.0 <= microtesla <= 70.0 else Grade.WARN
    words = f"field strength {microtesla:.1f} µT"
    if grade is Grade.WARN:
        hint = likely_field_unit(strength)
        words += f" is not the Earth's (20 to 70 µT){': ' + hint if hint else ''}"
    return Check("strength", Aspect.QUALITY, grade, words)


def _not_shown(figures: Mapping[str, float], knowledge: Knowledge) -> tuple[str, ...]:
    found = [NO_YAW]
    level, tilted = figures["heading_sigma"], figures["heading_sigma_tilted"]
    if tilted > 2.0 * level and tilted * DEGREES > 0.5:
        found.append(
            "the hard iron along the turn's axis, well: it costs "
            f"{tilted * DEGREES:.1f}° (1σ) of heading at 10° of tilt"
        )
    if "gyro_compass_rms" not in figures:
        found.append(NO_GYRO)
    if not knowledge.reference.is_complete:
        found.append(NO_REFERENCE)
    return tuple(found)


def _summary(verdict: Verdict, estimate: Estimate, figures: Mapping[str, float]) -> str:
    grades = f"quality {verdict.quality.value}, confidence {verdict.confidence.value}"
    if not verdict.accepted:
        causes = "; ".join(c.words for c in verdict.checks if c.grade is Grade.REFUSED)
        return f"Refused ({grades}): {causes}."
    x, y, z = (float(value) * 1e6 for value in estimate.correction.hard_iron)
    words = (
        f"{grades}: heading ±{figures['heading_sigma'] * DEGREES:.2f}° on the level, "
        f"±{figures['heading_sigma_tilted'] * DEGREES:.2f}° at 10° of tilt (1σ); "
        f"hard iron ({x:.1f}, {y:.1f}, {z:.1f}) µT"
    )
    if estimate.installation is not None:
        roll, pitch = estimate.installation.roll, estimate.installation.pitch
        words += f", installation roll {roll * DEGREES:.2f}°, pitch {pitch * DEGREES:.2f}°"
    warnings = "; ".join(check.words for check in verdict.checks if check.grade is Grade.WARN)
    return f"Calibrated, {words}.{' But ' + warnings + '.' if warnings else ''}"
