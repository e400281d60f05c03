"""A calibration seen on samples that it was not made from, in the form of an estimate."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.attitude import unit
from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.calibration import Calibration
from magcal_ros.core.estimate import Estimate
from magcal_ros.core.holds import Check, Finding, State
from magcal_ros.core.verdict import Aspect, Grade, Verdict
from magcal_ros.core.verdict import Check as GradedCheck
from magcal_ros.core.window import Window

WIDE_ARC = math.radians(270.0)
"""A shorter turn leaves headings unchecked."""

GRADES = {State.HOLDS: Grade.GOOD, State.DOUBTFUL: Grade.WARN, State.STALE: Grade.REFUSED}


def applied(
    window: Window, up: FloatArray, arc: float, calibration: Calibration, check: Check
) -> Outcome:
    """Return what a report needs to show how a calibration fares on a fresh window.

    Parameters
    ----------
    window : Window
        The fresh samples.
    up : ndarray, shape (n, 3)
        Up in body axes at each sample.
    arc : float
        Radians of the turn that were seen.
    calibration : Calibration
        The calibration in question.
    check : Check
        What was found about it.

    Returns
    -------
    Outcome
        Its estimate holds the old numbers and the new residuals; its verdict is the check.
    """
    correction = calibration.correction
    field = correction.apply(window.field)
    misfit = field - expected_field(field, up, calibration.strength, calibration.inclination)
    estimate = Estimate(
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
        residual=np.linalg.solve(correction.matrix, misfit.T).T,
        message="checked on other samples than it was made from",
    )
    checks = (*(_graded(finding) for finding in check.findings), _seen(arc))
    return Outcome(Verdict(checks, check.not_shown, check.summary), calibration, estimate)


def expected_field(
    field: FloatArray, up: FloatArray, strength: float, inclination: float
) -> FloatArray:
    """Return the field (n, 3) of given strength and inclination at the heading of `field`."""
    rise = np.sum(field * up, axis=1, keepdims=True)
    level = unit(field - rise * up)
    return np.asarray(strength * (math.cos(inclination) * level - math.sin(inclination) * up))


def _seen(arc: float) -> GradedCheck:
    grade = Grade.GOOD if arc >= WIDE_ARC else Grade.WARN
    return GradedCheck("arc", Aspect.CONFIDENCE, grade, f"{math.degrees(arc):.0f}° of a turn seen")


def _graded(finding: Finding) -> GradedCheck:
    return GradedCheck(finding.figure, Aspect.QUALITY, GRADES[finding.state], finding.words)
