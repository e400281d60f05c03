"""A turn's refusal where the sensors' axes are behind it, in the words of the page."""

from __future__ import annotations

from magcal_ros.core.assessment.axes import GYRO_IS_WRONG, MISLED_BY_AXES, find_axes
from magcal_ros.core.doctor.page import examine_window
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.gyro_signs import gyro_contradicts
from magcal_ros.core.samples.stamps import bursts_of_a_turn
from magcal_ros.core.samples.units import explained
from magcal_ros.core.samples.window import Window

AXES = ("gyro_axes", "field_axes", "force_axes", "rate_unit")
"""Lines of the page that say why field, gyro and gravity disagree."""


def wrong_axes(window: Window, knowledge: Knowledge) -> Refusal | None:
    """Return the refusal of a turn whose axes are certainly wrong; None where they may be right.

    Which sensor errs is for the page to say; that one does is judged as cheaply as can be.
    """
    if gyro_contradicts(window):
        return Refusal(Reason.AXES_DISAGREE, _by_the_page(window, knowledge) or GYRO_IS_WRONG)
    found = find_axes(window, knowledge)
    if found is None or found.right or found.meant is None:
        return None
    return wrong_stamps(window) or Refusal(
        Reason.AXES_DISAGREE, _by_the_page(window, knowledge) or found.words
    )


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
    words = _by_the_page(window, knowledge)
    return Refusal(Reason.AXES_DISAGREE, words) if words else refusal


def _by_the_page(window: Window, knowledge: Knowledge) -> str:
    findings = examine_window(window, knowledge).findings
    return "; ".join(f.remedy for f in findings if f.is_wrong and f.key in AXES)
