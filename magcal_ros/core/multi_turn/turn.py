"""Each turn by itself, and whether it shows the same calibration as the others.

Two hypotheses are compared: one calibration for all turns, or one for the turn and another for the
rest. Both are fitted, each with its own noise. The difference of their evidences is twice the log
likelihood ratio.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.assessment.verdict import Verdict, judge, refuse
from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.doctor.page import blamed_on_axes, wrong_axes
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.checks import check_window
from magcal_ros.core.methods.maximum_likelihood import check, estimate_of, smoothed
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.fit import Fit
from magcal_ros.core.smoother.kinds_of_motion import Smoothed
from magcal_ros.core.smoother.several import Together, fit_together
from magcal_ros.core.smoother.unknowns import AT

LOOKED_AT = 2.0
"""Misfit below which turns are not compared further; this only saves time."""
LEAST = 0.03
"""Share of a turn's own variance that the others take away at least, or they tell it nothing."""
IRON = AT["iron"]


@dataclass(frozen=True)
class Agreement:
    """How turns agree."""

    misfit: float
    """How many times as far as noise explains the hard iron of one is off that of all, at worst."""
    odd: int | None = None
    """The turn that most likely has another calibration than the rest; None if none has."""


def agreement(alone: Sequence[Fit], together: Together, yaw_sigma: float) -> Agreement:
    """Compare each turn with all others; of two that disagree the later one is the odd one.

    `alone` are the fits of each turn by itself, `yaw_sigma` (rad) is the prior of the
    installation's yaw.
    """
    misfit = max(_misfit(one, joint) for one, joint in zip(alone, together.fits, strict=True))
    if misfit < LOOKED_AT or len(alone) < 2:
        return Agreement(misfit)
    asked = range(len(alone)) if len(alone) > 2 else [1]
    gains = {k: _gain(alone, k, together, yaw_sigma) for k in asked}
    odd = max(gains, key=lambda k: gains[k])
    return Agreement(misfit, odd if gains[odd] > 0.0 else None)


def _gain(alone: Sequence[Fit], odd: int, together: Together, yaw_sigma: float) -> float:
    """Return twice the log likelihood ratio of a calibration of its own for one turn."""
    rest = fit_together([each for k, each in enumerate(alone) if k != odd], yaw_sigma)
    own = fit_together([alone[odd]], yaw_sigma)
    return together.evidence - rest.evidence - own.evidence


def _misfit(alone: Fit, joint: Fit) -> float:
    """Return the RMS difference of hard iron in its own sigmas.

    The answer of all varies with that of each, so that the variance of their difference is the
    difference of their variances (Hausman, Econometrica 46, 1978).
    """
    values, vectors = np.linalg.eigh(alone.covariance[IRON, IRON])
    whiten = vectors / np.sqrt(np.maximum(values, 1e-12))
    shares, turned = np.linalg.eigh(whiten.T @ joint.covariance[IRON, IRON] @ whiten)
    off = turned.T @ whiten.T @ (alone.state.shared - joint.state.shared)[IRON]
    return float(np.sqrt(np.mean(off**2 / np.maximum(1.0 - shares, LEAST))))


SHORT = (Reason.ARC_TOO_SHORT, Reason.AMBIGUOUS)
"""Reasons that forbid a turn to stand alone and that other turns may mend."""

GUESSED = (Reason.CIRCLE_TOO_SMALL, Reason.AXIS_ALONG_FIELD, Reason.FIELD_TOO_STEEP)
"""The same where nothing is known of the field: one turn can only guess how steep it is."""

COPIED = 0.5
"""Share of samples in common from which a turn is a copy of another."""


@dataclass(frozen=True, eq=False)
class Turn:
    """One turn and its own fit."""

    name: str
    window: Window
    verdict: Verdict
    """As if it were the only turn."""
    answer: Estimate | None = None
    """What its own fit comes to; None where there is no fit."""
    smoothed: Smoothed | None = None
    """Its fits; None where there is none."""
    reason: Reason | None = None
    """Why it cannot stand alone, if it cannot."""
    unfit: str = ""
    """Why it cannot join; empty if it may."""

    @property
    def estimate(self) -> Estimate | None:
        """Its answer, if it can stand alone."""
        return self.answer if self.reason is None else None

    @property
    def own_answer(self) -> Estimate:
        """Its answer, of a turn that has one."""
        assert self.answer is not None
        return self.answer

    @property
    def own(self) -> Smoothed:
        """Its fits, of a turn that has some."""
        assert self.smoothed is not None
        return self.smoothed

    @property
    def fit(self) -> Fit:
        """The fit of its most likely kind of motion."""
        return self.own.fit

    def left_out(self, words: str) -> Turn:
        """Return the turn with a reason not to join."""
        return replace(self, unfit=words)


def survey(windows: Sequence[Window], names: Sequence[str], knowledge: Knowledge) -> list[Turn]:
    """Fit each turn alone; what cannot join says why."""
    turns: list[Turn] = []
    for window, name in zip(windows, names, strict=True):
        twin = next((t for t in turns if _is_copy(window, t.window)), None)
        turn = _alone(window, name, knowledge)
        if twin is not None:
            turn = turn.left_out(f"it holds the same samples as {twin.name}")
        turns.append(turn)
    return turns


def _alone(window: Window, name: str, knowledge: Knowledge) -> Turn:
    found = estimate = None
    try:
        check_window(window, knowledge)
        found = smoothed(window, knowledge)
        estimate = estimate_of(found, window, knowledge)
        check(found, estimate, window, knowledge)
    except Refusal as refusal:
        why = blamed_on_axes(refusal, window, knowledge)
        mended = estimate is not None and _may_be_mended(refusal.reason, knowledge)
        unfit = "" if mended else str(why).rstrip(".")
        return Turn(name, window, refuse(why), estimate, found, why.reason, unfit)
    wrong = wrong_axes(window, knowledge)
    if wrong is not None:
        return Turn(name, window, refuse(wrong), estimate, found, wrong.reason, str(wrong))
    verdict = judge(estimate, knowledge, window)
    unfit = verdict.summary.rstrip(".") if verdict.quality is Grade.REFUSED else ""
    return Turn(name, window, verdict, estimate, found, unfit=unfit)


def _may_be_mended(reason: Reason, knowledge: Knowledge) -> bool:
    reference = knowledge.reference
    guessed = reference.strength.is_unknown and reference.inclination.is_unknown
    return reason in SHORT or (guessed and reason in GUESSED)


def _is_copy(window: Window, other: Window) -> bool:
    """Return whether most samples of the shorter window are in the other too."""
    if not len(window) or not len(other):
        return False
    common = np.isin(_keys(window), _keys(other)).sum()
    return bool(common > COPIED * min(len(window), len(other)))


def _keys(window: Window) -> np.ndarray[tuple[int, ...], np.dtype[np.void]]:
    """Return each sample's field and force as one key; stamps may have been moved."""
    rows = np.ascontiguousarray(np.hstack([window.field, window.specific_force]))
    return rows.view(np.dtype((np.void, rows.dtype.itemsize * rows.shape[1]))).ravel()
