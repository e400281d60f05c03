"""Grades, and the one table of the bounds between them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum


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
    """The bounds of three grades for one figure, of which only the size counts.

    Parameters
    ----------
    figure : str
        Name in `Estimate.figures`.
    aspect : Aspect
        Quality or confidence.
    excellent, good, warn : float
        Worst values of these grades, in the unit people see; beyond `warn` it is refused.
    unit : str
        Unit people see: "°", "%", "σ", "" ...
    scale : float
        Figure (SI) times this gives the unit people see.
    words : str
        What the figure is.
    remedy : str
        What to do when it falls short.
    at_least : bool
        Whether more is better; usually less is.
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
    at_least: bool = False

    def check(self, figure: float) -> Check:
        """Grade one value of the figure."""
        value = abs(figure * self.scale)
        bounds = ((Grade.EXCELLENT, self.excellent), (Grade.GOOD, self.good))
        grade = next((g for g, bound in bounds if self._holds(value, bound)), Grade.WARN)
        if not (math.isfinite(value) and self._holds(value, self.warn)):
            grade = Grade.REFUSED
        words = f"{self.words} {value:.3g}{self.unit}"
        if grade.rank >= Grade.WARN.rank:
            limit = self.good if grade is Grade.WARN else self.warn
            side = "more" if self.at_least else "less"
            words += f" (want {limit:g}{self.unit} or {side}): {self.remedy}"
        return Check(self.figure, self.aspect, grade, words)

    def _holds(self, value: float, bound: float) -> bool:
        return value >= bound if self.at_least else value <= bound


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
        0.7,
        2.0,
        "°",
        DEGREES,
        "predicted heading error on the level (1σ)",
        "see the full circle or all orientations, more slowly, and give the reference field",
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
        "radius of the field against the reference",
        "check reference.strength_ut and inclination_deg, or look for soft iron and steel near by",
    ),
    Threshold(
        "ellipse_excess",
        Aspect.QUALITY,
        2.0,
        12.0,
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
        1.0,
        4.0,
        "°",
        DEGREES,
        "headings from the two halves of the turn differ by",
        "turn once more, evenly, away from moving iron",
    ),
    Threshold(
        "gyro_compass_rms",
        Aspect.QUALITY,
        1.0,
        2.0,
        10.0,
        "°",
        DEGREES,
        "gyro against compass around the turn",
        "the field is distorted here, or the sensors' axes do not belong together; turn elsewhere",
    ),
    Threshold(
        "strength_pull",
        Aspect.QUALITY,
        1.5,
        3.0,
        5.0,
        "σ",
        1.0,
        "field strength pulled from the reference by",
        "check reference.strength_ut, or turn where the field is undisturbed",
    ),
    Threshold(
        "inclination_pull",
        Aspect.QUALITY,
        1.5,
        3.0,
        5.0,
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
    Threshold(
        "installation_yaw_sigma",
        Aspect.CONFIDENCE,
        0.5,
        3.0,
        10.0,
        "°",
        DEGREES,
        "yaw of the installation (1σ)",
        "turn on a slope",
    ),
    Threshold(
        "misalignment",
        Aspect.QUALITY,
        0.5,
        1.5,
        5.0,
        "°",
        DEGREES,
        "the corrected field is turned against the IMU, as gravity shows, by",
        "this method does not correct it; give mount_rpy_deg, or use a method that does",
    ),
    Threshold(
        "unseen_soft_iron",
        Aspect.CONFIDENCE,
        0.5,
        1.0,
        10.0,
        "°",
        DEGREES,
        "heading error (1σ) if there is as much soft iron as believed",
        "part of a turn cannot show soft iron; turn the full circle, or give soft_iron_gains",
    ),
    Threshold(
        "arc",
        Aspect.CONFIDENCE,
        300.0,
        160.0,
        44.0,
        "°",
        DEGREES,
        "the turn covers",
        "turn the full circle",
        at_least=True,
    ),
    Threshold(
        "samples",
        Aspect.CONFIDENCE,
        100.0,
        50.0,
        19.0,
        "",
        1.0,
        "believed samples:",
        "turn more slowly, or raise the rate of the topics",
        at_least=True,
    ),
    Threshold(
        "rival_gap",
        Aspect.CONFIDENCE,
        0.3,
        1.0,
        5.0,
        "°",
        DEGREES,
        "another calibration explains the turn as well, and its heading differs by",
        "turn the full circle on level ground, and give the reference field",
    ),
    Threshold(
        "up_noise",
        Aspect.QUALITY,
        0.5,
        1.5,
        6.0,
        "°",
        DEGREES,
        "noise of up (1σ)",
        "turn more slowly and evenly, or keep the accelerometer from shaking",
    ),
    Threshold(
        "field_noise_ratio",
        Aspect.QUALITY,
        2.0,
        4.0,
        10.0,
        "%",
        PERCENT,
        "noise of the field against its strength",
        "average the magnetometer more, or move it away from motors and cables",
    ),
    Threshold(
        "sideways_pull",
        Aspect.QUALITY,
        1.0,
        1.5,
        45.0,
        "°",
        DEGREES,
        "acceleration leans from the gyro's axis over the turn by",
        "turn more slowly and on the spot; or the gyro has a large bias, or axes that differ",
    ),
    Threshold(
        "axis_lean",
        Aspect.QUALITY,
        20.0,
        45.0,
        90.0,
        "°",
        DEGREES,
        "the turn's axis leans from the body's z by",
        "z points down or sideways at rest, REP-103 wants z up; turn the axes in the driver, and"
        " check that acceleration is not published as gravity (+9.81 upwards at rest)",
    ),
)
"""The one table of bounds; they come from simulation and about ten recordings, so move them."""

EARTHS_FIELD_UT = (20.0, 70.0)
"""Outside of these a strength is no Earth's: a warning that names the likely unit."""

GRAVITY_MISFITS = (0.03, 0.15)
"""How far the accelerometer's length may be off gravity: excellent, good; beyond it warns."""
