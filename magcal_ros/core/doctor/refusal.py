"""A turn's refusal where the sensors' axes are behind it, in the words of the page."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.assessment.axes import GYRO_IS_WRONG, MISLED_BY_AXES, find_axes
from magcal_ros.core.doctor.explanations import rate_factors
from magcal_ros.core.doctor.health import alive_finding, field_findings, unchanging
from magcal_ros.core.doctor.page import examine_window
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.stamps import bursts_of_a_turn
from magcal_ros.core.samples.units import explained
from magcal_ros.core.samples.window import Window, stretch_of

AXES = ("axes", "gyro_axes", "field_axes", "force_axes", "rate_unit")
"""Lines of the page that say why field, gyro and gravity disagree."""


SMOOTH = 1e-4
"""Share of its largest value by which a rate without noise may bend from sample to sample."""


def wrong_axes(window: Window, knowledge: Knowledge) -> Refusal | None:
    """Return the refusal of a turn whose axes are certainly wrong; None where they may be right.

    Which sensor errs is for the page to say; that one does is judged as cheaply as can be.
    """
    refusal = wrong_gyro(window, knowledge)
    if refusal is not None:
        return refusal
    if gyro_contradicts(window):
        return Refusal(Reason.AXES_DISAGREE, _by_the_page(window, knowledge) or GYRO_IS_WRONG)
    found = find_axes(window, knowledge)
    if found is None or found.right or found.meant is None:
        return None
    return wrong_stamps(window) or Refusal(
        Reason.AXES_DISAGREE, _by_the_page(window, knowledge) or found.words
    )


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
    if stretch is not None and set(rate_factors(stretch) or ()) - {1.0}:
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
    """Return the refusal of a turn that was not seen, or what the page says of the sensors."""
    gyro = wrong_gyro(window, knowledge)
    if gyro is not None:
        return gyro
    words = _by_the_page(window, knowledge)
    return Refusal(Reason.AXES_DISAGREE, words) if words else refusal


def _by_the_page(window: Window, knowledge: Knowledge, lines: tuple[str, ...] = AXES) -> str:
    findings = examine_window(window, knowledge).findings
    return "; ".join(f.remedy for f in findings if f.is_wrong and f.key in lines)


@dataclass(frozen=True)
class GyroSignsTuning:
    """When a gyro is said to contradict the accelerometer."""

    span: float = 0.5
    """Seconds over which turns are compared: shorter ones drown in noise, longer ones in bias."""
    contradicts: float = 1.5
    """Share of gravity's changes that a gyro at odds with them leaves at least: it makes more of
    them than there was."""
    explained: float = 0.6
    """Share that other signs may leave at most; the rest is a hand's acceleration."""


def gyro_contradicts(window: Window, tuning: GyroSignsTuning = GyroSignsTuning()) -> bool:
    """Return whether axes of the gyro turn against gravity, whichever they are.

    A body that turns by a small angle d sees up change by -d x up. On the level nothing of it
    shows, and nothing is said.
    """
    if window.angular_rate is None or len(window) < 3:
        return False
    steps = np.diff(window.time)
    turned = np.zeros((len(window), 3))
    mean = 0.5 * (window.angular_rate[1:] + window.angular_rate[:-1])
    turned[1:] = np.cumsum(mean * steps[:, None], axis=0)
    later = np.searchsorted(window.time, window.time + tuning.span)
    first = np.flatnonzero(later < len(window))
    last = later[first]
    near = window.time[last] - window.time[first] < 2.0 * tuning.span
    first, last = first[near], last[near]
    if not len(first):
        return False
    up = unit(window.specific_force)
    seen, middle, turn = up[last] - up[first], up[last] + up[first], turned[last] - turned[first]
    left = {
        signs: float(np.sum((seen + np.cross(turn * signs, 0.5 * middle)) ** 2))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    }
    best = min(left.values())
    changes = float(np.sum(seen**2))
    as_given = left[1.0, 1.0, 1.0]
    return as_given > tuning.contradicts * changes and best < tuning.explained * changes
