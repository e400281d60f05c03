"""Grades of figures, and whether the reference field is doubtful.

The hard iron along a turn's axis is the measured field along the axis minus that of the reference.
An inclination with the wrong sign therefore looks like a magnet of twice the reference's component,
and nothing else in the turn contradicts it. A robot may carry such a magnet: the user must decide.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.errors import Reason
from magcal_ros.core.knowledge import Knowledge


class Grade(str, Enum):
    """Grades from best to worst; a refused calibration is not put in force automatically."""

    EXCELLENT = "excellent"
    GOOD = "good"
    WARN = "warn"
    REFUSED = "refused"

    @property
    def rank(self) -> int:
        """Zero for the best."""
        return list(Grade).index(self)


class Aspect(str, Enum):
    """Which of the two grades a check belongs to."""

    QUALITY = "quality"
    CONFIDENCE = "confidence"


DEGREES = 180.0 / math.pi
SCALES = {"°": DEGREES, "%": 100.0, " µT": 1e6, " ms": 1e3}
"""Factors from SI to displayed units; other units have no factor."""


CHECK_MOUNTING = (
    "is the sensor mounted like this? Then give its pose with mount_rpy_deg; if not, the result "
    "is wrong: turn again on the spot, with a gyro"
)
"""Question and remedy for a large installation error."""


@dataclass(frozen=True)
class Bound:
    """The bounds of the grades for one figure; only its absolute value counts."""

    figure: Figure
    limits: tuple[float | None, float, float]
    """Worst values of excellent (None if there is no such grade), good and warn, in `unit`."""
    words: str  # description of the figure
    remedy: str  # advice if the grade is not good
    unit: str = "°"  # displayed unit: "°", "%", "σ", ""
    aspect: Aspect = Aspect.QUALITY
    at_least: bool = False  # whether larger values are better
    after_full: str = ""  # remedy after a full circle; empty if it is the same
    when_refused: str = ""  # remedy beyond `warn`; empty if it is the same

    @property
    def good(self) -> float:
        """Worst value of this grade."""
        return self.limits[1]

    @property
    def warn(self) -> float:
        """Worst value of this grade, beyond which a calibration is refused."""
        return self.limits[2]

    @property
    def scale(self) -> float:
        """Factor from SI to the displayed unit."""
        return SCALES.get(self.unit, 1.0)

    def check(
        self,
        figure: float,
        *,
        excess: float | None = None,
        note: str = "",
        before: float | None = None,
        rule: str = "",
    ) -> Check:
        """Grade one value of the figure.

        `figure` is in SI units; `excess` is the part of it that is graded, by default all. `note`
        is added to the value; `before` is the figure of the raw field, SI units. `rule` replaces
        the description of the limit.
        """
        value = abs(figure * self.scale)
        counted = value if excess is None else abs(excess * self.scale)
        limits = [math.nan if each is None else each for each in self.limits]
        kept = [counted >= each if self.at_least else counted <= each for each in limits]
        grade = Grade.REFUSED
        if any(kept) and math.isfinite(counted):
            grade = list(Grade)[kept.index(True)]
        words = f"{self.words} {shown(value)}{self.unit}{note}"
        if grade.rank >= Grade.WARN.rank:
            limit = self.good if grade is Grade.WARN else self.warn
            side = "more" if self.at_least else "less"
            refused = self.when_refused if grade is Grade.REFUSED else ""
            words = f"{self.words} {shown_beside(value, limit)}{self.unit}{note}"
            rule = rule or f"want {limit:g}{self.unit} or {side}"
            words += f" ({rule}): {refused or self.remedy}"
        raw = None if before is None else before * self.scale
        return Check(self.figure, self.aspect, grade, words, value, raw, self)


def shown(value: float) -> str:
    """Write a number with three digits, without powers of ten."""
    if 0.0 < value < 1e-3:
        return "below 0.001"
    return f"{value:.0f}" if 999.5 <= value < 1e7 else f"{value:.3g}"


def shown_beside(value: float, limit: float) -> str:
    """Write a number with enough digits to differ from a limit that it misses."""
    digits = (f"{value:.{count}g}" for count in range(4, 9))
    others = (text for text in digits if text != f"{limit:g}")
    return shown(value) if shown(value) != f"{limit:g}" else next(others, shown(value))


@dataclass(frozen=True)
class Check:
    """One figure, graded and put into words."""

    figure: Figure | Reason  # the figure, or the reason of a refusal
    aspect: Aspect
    grade: Grade
    words: str  # the result in words, with a remedy if the grade is not good
    value: float | None = None
    before: float | None = None
    """The figure in the displayed unit, and that of the raw field."""
    bound: Bound | None = None
    is_judged: bool = True  # false if the samples are too uncertain

    @property
    def name(self) -> str:
        """Description of the figure."""
        return "" if self.bound is None else self.bound.words

    @property
    def unit(self) -> str:
        """Displayed unit."""
        return "" if self.bound is None else self.bound.unit

    @property
    def key(self) -> str:
        """Its name in JSON and status."""
        return self.figure.key if isinstance(self.figure, Figure) else self.figure.value


def worst(grades: list[Grade]) -> Grade:
    """Return the worst of some grades; refused if there are none."""
    return max(grades, key=lambda grade: grade.rank, default=Grade.REFUSED)


@dataclass(frozen=True)
class ReferenceCheckTuning:
    """When a hard iron along the axis makes the reference doubtful."""

    likelier: float = 7.0  # likelihood ratio from which the inclination's other sign is named
    unusual: float = 0.025
    """Probability of as much hard iron along the axis below which there is a warning."""
    shown: float = 10.0
    """Sigmas from which the wobble of the turn excludes the other sign."""


TUNING = ReferenceCheckTuning()


def check_reference(
    estimate: Estimate, figures: Mapping[Figure, float], knowledge: Knowledge
) -> Check | None:
    """Check the hard iron along the turn's axis; None if the samples determine it, too."""
    if not knowledge.reference.is_complete or _is_shown(estimate, figures):
        return None
    axial_field = -estimate.strength * math.sin(estimate.inclination)
    correction = estimate.correction
    iron = correction.matrix @ correction.hard_iron
    axial = float(estimate.axis @ iron)
    own, other = abs(axial), abs(axial + 2.0 * axial_field)
    across = max(float(iron @ iron) - axial**2, axial_field_variance(knowledge))
    as_much = 1.0 - own / math.sqrt(across + own**2)
    words = f"hard iron along the turn's axis, by the reference field, {_microtesla(own)}"
    found = Grade.EXCELLENT
    if is_likelier(other, own, across):
        found = Grade.WARN
        words += (
            f", but {_microtesla(other)} if the inclination had the other sign: check the sign of "
            "reference.inclination_deg (positive where the field points down, as in the north), "
            "or turn on ramps; a simulator may publish the field in NED axes (Gazebo: "
            "use_earth_frame_ned false)"
        )
    elif own > estimate.strength and as_much < TUNING.unusual:
        found = Grade.WARN
        words += (
            f", more than the field itself ({_microtesla(estimate.strength)}): check "
            "reference.strength_ut and inclination_deg, or turn on ramps"
        )
    return Check(Figure.AXIAL_IRON, Aspect.CONFIDENCE, found, words)


def is_likelier(other: float, own: float, across: float) -> bool:
    """Return whether the inclination's other sign is much likelier.

    `own` and `other` are the hard iron along the axis by the reference and by the other sign,
    tesla, `across` is the squared hard iron across the axis. For a scale-free, isotropic prior and
    a component L across the axis, the density of the component z along it is (L² + z²)^(-3/2).
    """
    return bool(((across + own**2) / (across + other**2)) ** 1.5 > TUNING.likelier)


def axial_field_variance(knowledge: Knowledge) -> float:
    """Return the variance of the field along the axis by the reference, tesla²; never zero."""
    strength, dip = knowledge.reference.strength, knowledge.reference.inclination
    by_dip = strength.value * math.cos(dip.value) * dip.sigma
    return (math.sin(dip.value) * strength.sigma) ** 2 + by_dip**2 + 1e-18


def _is_shown(estimate: Estimate, figures: Mapping[Figure, float]) -> bool:
    """Whether the samples alone would contradict the other sign."""
    if Figure.INSTALLATION_YAW_SIGMA in figures or Figure.SPHERE_EXTENT in figures:
        return True
    wobble, count = figures.get(Figure.WOBBLE, 0.0), np.count_nonzero(estimate.inliers)
    axial_field = estimate.strength * math.sin(abs(estimate.inclination))
    noise = math.hypot(estimate.noise_field, axial_field * estimate.noise_up)
    swing = 2.0 * axial_field * wobble * math.sqrt(2.0 * count)
    return swing > TUNING.shown * noise


def _microtesla(value: float) -> str:
    return f"{shown(value * 1e6)} µT"


def level_field_sigma(knowledge: Knowledge) -> float:
    """Return the relative standard deviation of the reference's level field; 0 if unknown."""
    strength, dip = knowledge.reference.strength, knowledge.reference.inclination
    if strength.is_unknown or dip.is_unknown:
        return 0.0
    return math.hypot(
        strength.sigma / (abs(strength.value) or 1.0), math.tan(dip.value) * dip.sigma
    )
