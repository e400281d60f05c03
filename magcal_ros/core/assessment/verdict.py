"""Verdicts: the quality and the confidence of a calibration, in grades and in words.

Quality is whether the samples agree with the model; confidence is whether they determine the
calibration. The two are separate: a short, clean arc has a good quality and a low confidence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.assessment.bounds import (
    ALLOWED_SIGMAS,
    FULL_ARC_DEG,
    UPRIGHT,
    bounds_of,
)
from magcal_ros.core.assessment.grading import (
    DEGREES,
    Aspect,
    Bound,
    Check,
    Grade,
    check_reference,
    level_field_sigma,
    worst,
)
from magcal_ros.core.calibration.calibration import Estimate, Evidence
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import (
    CHECKED_TILT,
    axis_share,
    calibration_sigma,
    every_figure,
    sideways_acceleration,
    usual_lean,
)
from magcal_ros.core.errors import Refusal
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.units import (
    ROLLED,
    Z_NOT_UP,
    gravity_size,
    likely_acceleration_unit,
    unit_by_strength,
    was_turned_over,
)
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class VerdictTuning:
    """Limits and allowances of a verdict, from simulation and about ten recordings."""

    rough: float = math.radians(5.0)
    """Heading sigma from which a calibration is called rough in the summary, radians. In a car full
    of steel it may be the best possible."""
    one_axis: float = 0.7
    """Fraction of the gyro's squared rates about one axis from which a turn has one axis. For a
    sensor turned over by hand, the median orientation is used."""
    costly: tuple[float, float] = (math.radians(0.5), 2.0)
    """Heading sigma on a slope, radians, and its ratio to that on the level, from which unknown
    axial iron is mentioned."""
    earths_field_ut: tuple[float, float] = (20.0, 70.0)
    """Range of the Earth's field; outside it there is a warning with the likely unit."""
    guessed: float = 1.5  # factor by which that range is wider without a reference field
    beyond_iron_ut: tuple[float, float] = (2.0, 200.0)
    """Range of the field with iron on the robot; outside it the calibration is refused."""
    gravity_misfits: tuple[float, float] = (0.03, 0.15)
    """Relative deviation of acceleration from gravity: excellent, good; beyond it a warning."""
    reasons: int = 2  # how many reasons a summary names


TUNING = VerdictTuning()


@dataclass(frozen=True)
class Verdict:
    """The checks of one estimate, with its two grades."""

    checks: tuple[Check, ...]
    not_shown: tuple[str, ...]  # quantities that the samples do not determine
    headline: str = ""  # the result without reasons; empty for a refusal before the fit
    says: str = ""  # the summary, if it is not the headline with the reasons

    @property
    def summary(self) -> str:
        """The result with the first reasons against it, for a log."""
        if self.says:
            return self.says
        reasons = self.reasons
        more = len(reasons) - TUNING.reasons
        words = "; ".join(reasons[: TUNING.reasons]) + (f"; and {more} more" if more > 0 else "")
        if not self.accepted:
            return f"{self.headline}: {words}."
        return f"{self.headline} But {words}." if words else self.headline

    @property
    def reasons(self) -> tuple[str, ...]:
        """The reasons of a refusal, or the warnings of an accepted calibration."""
        grade = Grade.WARN if self.accepted else Grade.REFUSED
        return tuple(check.words for check in self.checks if check.grade is grade)

    @property
    def in_full(self) -> tuple[str, tuple[str, ...]]:
        """Return the result and all reasons against it; none if the summary contains them."""
        return (self.says, ()) if self.says else (self.headline, self.reasons)

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
        """Whether the calibration may be put in force without asking the user."""
        return Grade.REFUSED not in (self.quality, self.confidence)

    @property
    def is_good(self) -> bool:
        """Whether there is no refusal and no warning."""
        return max(self.quality.rank, self.confidence.rank) < Grade.WARN.rank

    def _worst(self, aspect: Aspect) -> Grade:
        return worst([check.grade for check in self.checks if check.aspect is aspect])

    def evidence(self, estimate: Estimate) -> Evidence:
        """Return the verdict in the form that is stored with a calibration."""
        return Evidence(
            estimate.method,
            self.quality.value,
            self.confidence.value,
            self.summary,
            tuple(check.words for check in self.checks),
            self.not_shown,
            figures={figure.value: value for figure, value in estimate.figures.items()},
        )


NO_YAW = (
    "the yaw of the installation: mount the sensor square to the robot, or compare with a known "
    "heading"
)
NO_MOUNTING = (
    "the mounting of the magnetometer against the IMU: this method assumes aligned axes and does "
    "not correct it"
)
REST_BESIDE_TURN = (
    "stand still for three seconds before and after the turn: that shows the gyro's bias, and"
    " whether there was a centripetal acceleration"
)
ON_THE_SPOT = (
    "turn on the spot: without a gyro the centripetal acceleration of a circle looks like a roll"
    " of the magnetometer"
)
NOT_COMPARED = (
    "a distorted room, mirrored axes or a sideways acceleration: gyro against compass was not"
    " checked, because "
)
NO_GYRO = NOT_COMPARED + "there is no gyro"
GYRO_UNUSED = NOT_COMPARED + "this method does not use the gyro"
FLAGS = {
    Figure.GYRO_CARRIED: (
        True,
        "the turn that the gyro measured explains the samples",
        "the turn that the gyro measured does not explain the samples: check the axes and the "
        "stamps of the gyro, and keep the sensor near the turn's centre, away from iron",
    ),
    Figure.NOT_CONVERGED: (
        False,
        "the optimisation converged",
        "the optimisation did not converge, so the errors may be larger than stated",
    ),
}
"""The wanted value of a flag, and the words if it has this value and if not."""
AGAIN = "turn once more, evenly, away from moving iron"
DRIVE_ELSEWHERE = "drive elsewhere, evenly, away from moving iron"
NO_REFERENCE = "the size of the field: the reference field is not known"
WHICH_WAY_UP = (
    "whether the IMU's z points up when the robot stands: the sensor was turned over, so nothing "
    "shows it"
)
LEVEL_ONLY = (
    "the hard iron along the vertical axis: its error may be larger than its sigma, so without the "
    "position rely on the heading on level ground only"
)


def judge(estimate: Estimate, knowledge: Knowledge, window: Window | None = None) -> Verdict:
    """Return the verdict on an estimate; `window` contains its samples, if any."""
    mounting = knowledge.mounting
    figures = {
        Figure.ARC: estimate.arc,
        Figure.SAMPLES: float(np.count_nonzero(estimate.inliers)),
        Figure.AXIS_LEAN: mounting.lean(estimate.axis),
    }
    figures |= every_figure(estimate)
    has_gyro = window is not None and window.angular_rate is not None
    if window is not None and has_gyro:
        if axis_share(window) < TUNING.one_axis:
            figures[Figure.AXIS_LEAN] = usual_lean(window, mounting)
        elif estimate.arc * DEGREES > FULL_ARC_DEG:
            # Only a full turn separates a steady sideways acceleration from a slope. A fit with
            # the gyro has estimated this acceleration, and the gyro's bias and axes.
            steady = figures.get(Figure.STEADY_ACCELERATION)
            angle = sideways_acceleration(window) if steady is None else math.atan(steady)
            figures.setdefault(Figure.SIDEWAYS_ACCELERATION, angle)
    if window is not None and was_turned_over(window):
        del figures[Figure.AXIS_LEAN]
    bounds = bounds_of(estimate)
    stands = window is not None and usual_lean(window, mounting) * DEGREES <= UPRIGHT.good
    context = estimate, figures, knowledge, ROLLED if stands else Z_NOT_UP
    checks = [_check(bound, *context) for bound in bounds if bound.figure in figures]
    doubt = check_reference(estimate, figures, knowledge)
    if doubt is not None:
        checks.append(doubt)
    checks.append(_check_strength(estimate.strength, knowledge))
    for figure, (is_good, good, bad) in FLAGS.items():
        if figure in figures:
            holds = bool(figures[figure]) is is_good
            grade, words = (Grade.EXCELLENT, good) if holds else (Grade.WARN, bad)
            if not holds and figure is Figure.NOT_CONVERGED:
                words += f": {DRIVE_ELSEWHERE if _is_drive(figures) else AGAIN}"
            checks.append(Check(figure, Aspect.QUALITY, grade, words))
    if window is not None:
        checks.append(_check_gravity(window))
    not_shown = _not_shown(estimate, figures, knowledge, has_gyro=has_gyro)
    verdict = Verdict(tuple(checks), not_shown)
    return replace(verdict, headline=_headline(verdict, estimate, figures))


def _is_drive(figures: Mapping[Figure, float]) -> bool:
    return Figure.HEADINGS_DRIVEN in figures


def _check(
    bound: Bound,
    estimate: Estimate,
    figures: Mapping[Figure, float],
    knowledge: Knowledge,
    against_lean: str,
) -> Check:
    """Grade one figure, allowing for the uncertainty of the reference.

    `against_lean` is the remedy for an axis that is not upright.
    """
    figure = figures[bound.figure]
    leans = figures.get(Figure.AXIS_LEAN, 0.0) * DEGREES > UPRIGHT.good
    if bound.figure is Figure.AXIS_LEAN or (bound.after_full and leans):
        bound = replace(bound, remedy=against_lean)
    elif bound.after_full and figures[Figure.ARC] * DEGREES > FULL_ARC_DEG:
        bound = replace(bound, remedy=bound.after_full)
    if bound.figure is Figure.HEADING_SIGMA:
        hidden = figures.get(Figure.POSSIBLE_ACCELERATION, 0.0)
        if hidden**2 > 0.5 * figure**2:
            bound = replace(bound, remedy=REST_BESIDE_TURN if _by_gyro(figures) else ON_THE_SPOT)
        if Figure.LOCAL_SIGMA in figures:
            # Local disturbances along a drive do not depend on the calibration.
            return bound.check(calibration_sigma(estimate))
        if not knowledge.reference.is_complete:
            bound = replace(bound, remedy=f"{bound.remedy}, and give the reference field")
    if bound.figure is Figure.SIDEWAYS_ACCELERATION and _by_gyro(figures):
        # The fit has subtracted it; the uncertainty is in the sigma.
        excellent, _, most = bound.limits
        bound = replace(bound, limits=(excellent, most, most))
    if bound.figure in (Figure.RADIUS_MISFIT, Figure.LEVEL_SHARE):
        allowed = ALLOWED_SIGMAS * level_field_sigma(knowledge)
        note = f" ± {100.0 * allowed:.2g}% ({ALLOWED_SIGMAS:g}σ)" if allowed else ""
        counted = min(figure + allowed, 1.0) if bound.at_least else max(figure - allowed, 0.0)
        return bound.check(figure, excess=counted, note=note)
    return bound.check(figure)


def _by_gyro(figures: Mapping[Figure, float]) -> bool:
    """Return whether the fit had a gyro, and so estimates the robot's acceleration."""
    return Figure.ON_THE_SPOT in figures


def refuse(refusal: Refusal) -> Verdict:
    """Return the verdict of a refusal."""
    words = str(refusal)
    checks = tuple(Check(refusal.reason, aspect, Grade.REFUSED, words) for aspect in Aspect)
    return Verdict(checks, (), says=f"Refused: {words.rstrip('.')}.")


def _check_strength(strength: float, knowledge: Knowledge) -> Check:
    microtesla = strength * 1e6
    low, high = TUNING.earths_field_ut
    if not knowledge.reference.is_complete:
        # Without a reference, one turn gives only a rough strength.
        low, high = low / TUNING.guessed, high * TUNING.guessed
    grade = Grade.EXCELLENT if low <= microtesla <= high else Grade.WARN
    hint = unit_by_strength(strength)
    published = f"{strength:.3g} T as published" if hint else f"{microtesla:.1f} µT"
    words = f"strength of the corrected field {published}"
    if grade is Grade.WARN:
        least, most = TUNING.beyond_iron_ut
        grade = grade if least <= microtesla <= most else Grade.REFUSED
        words += f" is not the Earth's ({low:.0f} to {high:.0f} µT){': ' + hint if hint else ''}"
    return Check(Figure.STRENGTH, Aspect.QUALITY, grade, words)


def gravity_fault(size: float) -> str:
    """Return the likely cause if a size of gravity, m/s² as published, is wrong; else empty."""
    if abs(size / STANDARD_GRAVITY - 1.0) <= TUNING.gravity_misfits[1]:
        return ""
    return likely_acceleration_unit(size) or "check the accelerometer's range and scale"


def _check_gravity(window: Window) -> Check:
    size = gravity_size(window.time, window.specific_force, window.angular_rate)
    is_excellent = abs(size / STANDARD_GRAVITY - 1.0) <= TUNING.gravity_misfits[0]
    grade = Grade.EXCELLENT if is_excellent else Grade.GOOD
    words = f"acceleration at rest {size:.3g} m/s²"
    if hint := gravity_fault(size):
        grade = Grade.WARN
        words += f" is not gravity's ({STANDARD_GRAVITY:.2f} m/s²): {hint}"
    return Check(Figure.GRAVITY, Aspect.QUALITY, grade, words)


def _not_shown(
    estimate: Estimate, figures: Mapping[Figure, float], knowledge: Knowledge, *, has_gyro: bool
) -> tuple[str, ...]:
    found = []
    if estimate.installation is None:
        found.append(NO_MOUNTING)
    elif Figure.INSTALLATION_YAW_SIGMA not in figures:
        found.append(NO_YAW)
    level, tilted = figures[Figure.HEADING_SIGMA], figures[Figure.HEADING_SIGMA_TILTED]
    least, times = TUNING.costly
    if tilted > times * level and tilted > least:
        known = knowledge.reference.is_complete
        found.append(
            "the hard iron along the turn's axis: it does not matter on level ground, but at 10° "
            f"of tilt its error in the heading is {tilted * DEGREES:.1f}° (1σ); "
            f"{'' if known else 'give the reference field, or '}"
            f"{'drive on slopes' if _is_drive(figures) else 'turn on ramps'}"
        )
    compared = {Figure.GYRO_COMPASS_SWING, Figure.HEADINGS_DRIVEN, Figure.KNOWN_HEADINGS}
    if not compared & set(figures):
        found.append(GYRO_UNUSED if has_gyro else NO_GYRO)
    if not knowledge.reference.is_complete:
        found.append(NO_REFERENCE)
        if _is_drive(figures) and Figure.AXIS_LEAN in figures:
            found.append(LEVEL_ONLY)
    if Figure.AXIS_LEAN not in figures:
        found.append(WHICH_WAY_UP)
    return tuple(found)


def _headline(verdict: Verdict, estimate: Estimate, figures: Mapping[Figure, float]) -> str:
    """Return the result without its reasons."""
    grades = f"quality {verdict.quality.value}, confidence {verdict.confidence.value}"
    where = _drive_in_words(figures)
    if not verdict.accepted:
        return f"Refused ({grades})"
    x, y, z = (float(value) * 1e6 for value in estimate.correction.hard_iron)
    level, tilted = figures[Figure.HEADING_SIGMA], figures[Figure.HEADING_SIGMA_TILTED]
    by, way = "", ""
    if Figure.LOCAL_SIGMA in figures:
        # The graded sigma comes first, as for a turn.
        by = " by the calibration"
        way = f"; along the drive, with local magnetic disturbances, ±{level * DEGREES:.2f}°"
        level, tilted = calibration_sigma(estimate), calibration_sigma(estimate, CHECKED_TILT)
    words = (
        f"{grades}: heading ±{level * DEGREES:.2f}° on level ground, "
        f"±{tilted * DEGREES:.2f}° at 10° of tilt (1σ){by}{way}; "
        f"hard iron ({x:.1f}, {y:.1f}, {z:.1f}) µT"
    )
    if estimate.installation is not None:
        roll, pitch = estimate.installation.roll, estimate.installation.pitch
        words += f", installation roll {roll * DEGREES:.2f}°, pitch {pitch * DEGREES:.2f}°"
        if Figure.INSTALLATION_YAW_SIGMA in figures:
            yaw, sigma = estimate.installation.yaw, figures[Figure.INSTALLATION_YAW_SIGMA]
            words += f", yaw {yaw * DEGREES:.2f}° ±{sigma * DEGREES:.2f}°"
    rough = " roughly" if level > TUNING.rough else ""
    return f"Calibrated{rough}{where}, {words}."


def _drive_in_words(figures: Mapping[Figure, float]) -> str:
    """Return the length of a drive, or the number of known headings; empty for a turn."""
    if count := int(figures.get(Figure.KNOWN_HEADINGS, 0)):
        return f" from {count} known headings" if count > 1 else " from one known heading"
    if not _is_drive(figures):
        return ""
    seconds, metres = figures[Figure.DRIVING_TIME], figures.get(Figure.METRES)
    took = f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"
    way = "" if metres is None else f"{metres / 1000.0:.1f} km, "
    seen = f"{figures[Figure.HEADINGS_DRIVEN]:.0f} of 12 headings"
    return f" from {took} of movement, {way}{seen}"
