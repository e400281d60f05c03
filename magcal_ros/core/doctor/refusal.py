"""A turn's refusal where the sensors' axes are behind it, in the words of the page."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.doctor.explanations import rate_factors
from magcal_ros.core.doctor.health import alive_finding, field_findings, unchanging
from magcal_ros.core.doctor.page import examine_window
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.stamps import bursts_of_a_turn
from magcal_ros.core.samples.units import MISLED_BY_AXES, explained
from magcal_ros.core.samples.window import Window, stretch_of

AXES = ("axes", "gyro_axes", "field_axes", "force_axes", "rate_unit")
"""Lines of the page that say why field, gyro and gravity disagree."""


SMOOTH = 1e-4
"""Share of its largest value by which a rate without noise may bend from sample to sample."""


def wrong_axes(window: Window, knowledge: Knowledge) -> Refusal | None:
    """Return the refusal of a turn whose axes are certainly wrong; None where they may be right."""
    refusal = wrong_gyro(window, knowledge)
    if refusal is not None or window.angular_rate is None:
        return refusal
    words = _by_the_page(window, knowledge, least=Grade.REFUSED)
    if not words:
        return None
    return wrong_stamps(window) or Refusal(Reason.AXES_DISAGREE, words)


def wrong_reading(window: Window, knowledge: Knowledge) -> Refusal | None:
    """Return the refusal of readings that no fit can use, seen before the work; None of others."""
    return saturated_field(window) or wrong_gyro(window, knowledge)


def wrong_gyro(window: Window, knowledge: Knowledge) -> Refusal | None:
    """Return the refusal of a turn whose gyro has dead axes or another unit; None of others.

    A dead axis hides what the robot leans by, and the gyro's turn cannot be followed in space.
    """
    rate = window.angular_rate
    if rate is None or len(window) < 3:
        return None
    dead = unchanging(rate)
    if 0 < len(dead) < 3 and _has_noise(np.delete(rate, dead, axis=1)):
        words = alive_finding("gyro", rate).remedy
        up = int(np.argmax(np.abs(window.specific_force.mean(axis=0))))
        if up in dead and len(dead) == 2:
            living = 3 - sum(dead)
            words += f", and gives the turn about {'xyz'[up]} as {'xyz'[living]}"
        return Refusal(
            Reason.AXES_DISAGREE,
            f"the gyro's {words}; correct the driver, or let it mark the rates as absent "
            "(angular_velocity_covariance[0] = -1; in a table, leave the columns out) to be "
            "calibrated without a gyro",
        )
    stretch = stretch_of(window)
    if stretch is not None and rate_factors(stretch):
        unit = _by_the_page(window, knowledge, ("rate_unit",))
        return Refusal(Reason.AXES_DISAGREE, unit) if unit else None
    return None


def _has_noise(rate: FloatArray) -> bool:
    """Return whether rates (n, k) have noise; those of a simulator without any may stay zero."""
    bend = np.abs(np.diff(rate, 2, axis=0))
    return bool(np.median(bend) > SMOOTH * np.abs(rate).max())


def saturated_field(window: Window) -> Refusal | None:
    """Return the refusal of a turn whose field stops at the end of a range; None of others.

    What is cut off there looks like a smaller hard iron.
    """
    if len(window) < 3:
        return None
    for found in field_findings(window.field):
        if found.is_wrong and found.key == "saturation":
            words = f"the magnetometer saturates ({found.evidence}): {found.remedy}"
            return Refusal(Reason.NO_SOLUTION, words)
    return None


def wrong_stamps(window: Window) -> Refusal | None:
    """Return the refusal of a turn with a gyro whose stamps come in bursts; None of others."""
    bursts = "" if window.angular_rate is None else bursts_of_a_turn(window.time)
    if not bursts:
        return None
    return Refusal(Reason.AXES_DISAGREE, f"gyro and field do not tell one turn: {bursts}")


def blamed_on_axes(refusal: Refusal, window: Window, knowledge: Knowledge) -> Refusal:
    """Return a method's refusal, or that of the wrong axes behind it."""
    wrong = wrong_axes(window, knowledge) if refusal.reason in MISLED_BY_AXES else None
    return explained(refusal, window) if wrong is None else wrong


def blamed_on_sensors(refusal: Refusal, window: Window, knowledge: Knowledge) -> Refusal:
    """Return the refusal of a turn that was not seen, or what the page finds of the sensors."""
    gyro = wrong_gyro(window, knowledge)
    if gyro is not None:
        return gyro
    words = _by_the_page(window, knowledge)
    return Refusal(Reason.AXES_DISAGREE, words) if words else refusal


def _by_the_page(
    window: Window, knowledge: Knowledge, lines: tuple[str, ...] = AXES, least: Grade = Grade.WARN
) -> str:
    findings = examine_window(window, knowledge).findings
    return "; ".join(f.remedy for f in findings if f.grade.rank >= least.rank and f.key in lines)
