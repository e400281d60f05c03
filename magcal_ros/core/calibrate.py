"""Fit one window or several, and grade the result; used by the node and the command line."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.assessment.verdict import Verdict, judge, refuse
from magcal_ros.core.calibration.calibration import Calibration, Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import predicted_heading_sigma
from magcal_ros.core.errors import Reason, Refusal, UsageError
from magcal_ros.core.geometry.rotations import in_axes
from magcal_ros.core.knowledge import Knowledge, in_level_axes, level_rotation
from magcal_ros.core.multi_turn.result import KeptTurns, MultiTurnReport
from magcal_ros.core.samples.battery import with_one_reference
from magcal_ros.core.samples.streams import SWAY
from magcal_ros.core.samples.window import Window, working_axes

# Modules that only a fit needs are imported by the functions that fit, because a node that starts
# with a saved calibration would wait for them before its first message.

Fit = Callable[[Window, Knowledge], Estimate]

_FITS = {
    "maximum_likelihood": "smoother.fit",
    "smoother": "smoother.fit_drive",
    "smoother_one": "smoother.fit",
    "design_tip": "design_tip.fit",
    "ellipsoid": "ellipsoid.fit",
    "min_max": "min_max.fit",
}
METHODS = tuple(_FITS)
"""Names of the methods, the recommended one first."""
JOINS, DRIVES, *_ = METHODS
"""The method that joins turns, and the one that takes a drive without a turn."""
ONE_SMOOTHER = JOINS, METHODS[2]  # two names of one method (doc/smoother.md)
METHOD_WORDS = (
    f"Method that makes a calibration from the samples. {JOINS}, also named {METHODS[2]}, is right "
    f"for turns and drives; {DRIVES} treats a turn as a drive; the others are for comparison"
)
POOL = ("ellipsoid", "min_max")
"""Methods that take all samples for one tumble."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """The result of fitting a window."""

    verdict: Verdict
    calibration: Calibration | None = None
    """Also if the verdict refuses it; None if there is no estimate."""
    estimate: Estimate | None = None
    reason: Reason | None = None  # why there is no estimate
    multi_turn: MultiTurnReport | None = None  # the report on the turns, if several were joined
    window: Window | None = None  # the samples; the estimate's residuals are of its rows

    @classmethod
    def refused(cls, refusal: Refusal, window: Window | None = None) -> Outcome:
        """Return the outcome of samples that do not determine a calibration."""
        return cls(refuse(refusal), reason=refusal.reason, window=window)

    def saying(self, words: str) -> Outcome:
        """Return the same outcome with another summary of its verdict."""
        return replace(self, verdict=replace(self.verdict, says=words))


def find_method(name: str) -> Fit:
    """Return the function of a method; its module is imported now. ValueError if it is unknown."""
    if name not in METHODS:
        raise ValueError(f"there is no method {name!r}; choose one of {', '.join(METHODS)}")
    module, function = _FITS[name].split(".")
    found = getattr(importlib.import_module(f"magcal_ros.core.methods.{module}"), function)
    return cast("Fit", found)


def calibrate(
    window: Window,
    knowledge: Knowledge,
    method: str = JOINS,
    progress: Callable[[float], object] | None = None,
) -> Outcome:
    """Fit the window of a turn or a drive, and grade the result.

    Bad data raise no exception: a refusal is a verdict.

    Parameters
    ----------
    window : Window
    knowledge : Knowledge
        What is known before the turn.
    method : str
        One of `METHODS`. The first takes turns and drives, with a gyro or without.
    progress : callable, optional
        Called with the fraction of the work that is done, if the fit takes long.

    Returns
    -------
    Outcome
    """
    from magcal_ros.core.doctor.sensor_report import refusal_by_axes, wrong_reading

    wrong = wrong_reading(window, knowledge)
    if wrong is not None:
        return Outcome.refused(wrong, window)
    fit = find_method(method)
    if progress is not None and method in ONE_SMOOTHER:
        fit = partial(cast("Callable[..., Estimate]", fit), progress=progress)
    try:
        estimate = in_level_axes(fit)(window, knowledge)
    except Refusal as refusal:
        return Outcome.refused(refusal_by_axes(refusal, window, knowledge), window)
    return _judged_by_axes_too(estimate, knowledge, window)


def _judged_by_axes_too(estimate: Estimate, knowledge: Knowledge, window: Window) -> Outcome:
    """Grade an estimate, and refuse it if the samples show wrong axes or stamps."""
    from magcal_ros.core.doctor.sensor_report import wrong_axes, wrong_stamps

    # A good result does not rule out wrong axes: a sensor turned by 90° about z fits a turn well.
    # The search is skipped if z points down, which explains all other faults. It cannot separate
    # wrong axes from a sway that is faster than the samples.
    outcome = judged(estimate, knowledge, window)
    explains = outcome.verdict.accepted and estimate.figures.get(Figure.GYRO_CARRIED, 1.0) > 0.0
    is_slow = float(np.median(np.diff(window.time))) > SWAY
    if explains and is_slow and estimate.method in (JOINS, DRIVES):
        return outcome
    refused = {each.figure for each in outcome.verdict.checks if each.grade is Grade.REFUSED}
    if Figure.AXIS_LEAN in refused:
        return outcome
    wrong = wrong_axes(window, knowledge) or (None if explains else wrong_stamps(window))
    return outcome if wrong is None else Outcome.refused(wrong, window)


def judged(estimate: Estimate, knowledge: Knowledge, window: Window | None = None) -> Outcome:
    """Grade an estimate; its residuals are of the rows of `window`."""
    verdict = judge(estimate, knowledge, window)
    evidence = verdict.evidence(estimate).made_with(knowledge.reference)
    calibration = Calibration.from_estimate(estimate, evidence)
    return Outcome(verdict, calibration, estimate, window=window)


def calibrate_drive(log: Window, knowledge: Knowledge) -> Outcome:
    """Fit the log of a drive and grade the result; the samples are the rows of the log."""
    from magcal_ros.core.doctor.sensor_report import wrong_reading
    from magcal_ros.core.methods.smoother import DRIVE_NEEDS_GYRO, fit_log

    if not len(log):
        words = "no drive was found: there are no samples with a gyro in which the robot moved"
        return Outcome.refused(Refusal(Reason.TOO_FEW_SAMPLES, words))
    if log.angular_rate is None:
        return Outcome.refused(Refusal(Reason.NO_SOLUTION, DRIVE_NEEDS_GYRO), log)
    wrong = wrong_reading(log, knowledge)
    if wrong is not None:
        return Outcome.refused(wrong, log)
    try:
        estimate = in_level_axes(fit_log)(log, knowledge)
    except Refusal as refusal:
        return Outcome.refused(refusal, log)
    return _judged_by_axes_too(estimate, knowledge, log)


def calibrate_turns(
    windows: Sequence[Window],
    knowledge: Knowledge,
    method: str = JOINS,
    names: Sequence[str] | None = None,
) -> Outcome:
    """Join turns into one estimate and grade it.

    A turn that contradicts the others is left out, with the reason. Bad data raise no exception.

    Parameters
    ----------
    windows : sequence of Window
        One for each turn; at least one.
    knowledge : Knowledge
        What is known before the turns, which are made in one place.
    method : str
        `maximum_likelihood` joins turns; `ellipsoid` and `min_max` take all samples as one tumble.
        Another raises `UsageError` for several turns.
    names : sequence of str, optional
        Names of the turns.

    Returns
    -------
    Outcome
    """
    if not windows:
        raise UsageError("there is no turn to calibrate; give the window of one turn at least")
    if names is not None and len(names) != len(windows):
        raise UsageError(f"{len(windows)} turns have {len(names)} names; give each turn one name")
    called = [f"turn {k + 1}" for k in range(len(windows))] if names is None else names
    if method in POOL:
        return calibrate(pooled(windows), knowledge, method)
    if method != JOINS:
        if len(windows) > 1:
            raise UsageError(f"the method {method} takes one turn; {JOINS} joins several")
        return calibrate(windows[0], knowledge, method)
    from magcal_ros.core.multi_turn.joined import join

    batteries = with_one_reference([window.battery for window in windows])
    both = zip(windows, batteries, strict=True)
    windows = [w if w.battery is b else replace(w, battery=b) for w, b in both]
    turns, joint, multi_turn = join(windows, called, knowledge)
    members = [turn for turn in turns if not turn.refusal_words]
    turn = (members or turns)[-1]
    window, from_level = windows[turns.index(turn)], level_rotation(knowledge.upward).T
    if joint is not None:
        outcome = judged(in_axes(joint, from_level), knowledge, window)
    elif turn.refusal_words and len(turns) > 1:
        each = "; ".join(f"{turn.name}: {turn.refusal_words}" for turn in turns)
        words = f"none of the turns can be used: {each}"
        outcome = Outcome.refused(Refusal(turn.reason or Reason.NO_SOLUTION, words), window)
    elif turn.estimate is not None and turn.reason is None:
        outcome = _judged_by_axes_too(in_axes(turn.estimate, from_level), knowledge, window)
    else:
        outcome = calibrate(window, knowledge)
    return replace(outcome, multi_turn=multi_turn)


def pooled(windows: Sequence[Window]) -> Window:
    """Return one window with the samples of all, with a pause of one second between them."""
    windows = [window for window in windows if len(window)]
    if not windows:
        return Window(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))
    times, end = [], 0.0
    for window in windows:
        times.append(window.time - window.time[0] + end)
        end = float(times[-1][-1]) + 1.0
    rates = [window.angular_rate for window in windows]
    known = [rate for rate in rates if rate is not None]
    return Window(
        np.concatenate(times) + windows[0].time[0],
        np.vstack([window.field for window in windows]),
        np.vstack([window.specific_force for window in windows]),
        np.vstack(known) if len(known) == len(rates) else None,
    )


def add_turn(
    kept: KeptTurns, window: Window, knowledge: Knowledge, method: str, accumulate: bool
) -> tuple[Outcome, KeptTurns]:
    """Fit a turn, jointly with the turns kept before it if `accumulate` is set.

    Only `maximum_likelihood` accumulates, and such a turn is not fitted as a drive. `knowledge` is
    used for all turns. Returns the outcome and the turns to keep, without a refused one.
    """
    if not accumulate:
        return calibrate(window, knowledge, method), KeptTurns()
    names = (*kept.names, kept.next_name)
    outcome = calibrate_turns([*kept.windows, window], knowledge, method, names)
    multi_turn = outcome.multi_turn
    if multi_turn is None or not multi_turn.turns[-1].joined:
        return _refused(outcome, kept), kept
    return outcome, kept.joined(window, multi_turn) if outcome.verdict.accepted else kept


def _refused(outcome: Outcome, kept: KeptTurns) -> Outcome:
    """Return the refusal of a new turn that did not join those before it."""
    if not kept.windows:
        return outcome
    why = (
        outcome.verdict.summary
        if outcome.multi_turn is None
        else outcome.multi_turn.turns[-1].words
    )
    count = len(kept.windows)
    words = (
        f"{kept.next_name} does not join the {'turn' if count == 1 else f'{count} turns'} before "
        f"it: {why.rstrip('.')}; the turns before are kept"
    )
    refusal = Refusal(outcome.reason or Reason.TURNS_DISAGREE, words)
    return replace(Outcome.refused(refusal), multi_turn=outcome.multi_turn)


@in_level_axes
def predicted_sigma(window: Window, knowledge: Knowledge, method: str = JOINS) -> float:
    """Return the sigma of the heading on the level by a fit of this window, radians.

    It is infinite without a fit.
    """
    try:
        if method in ONE_SMOOTHER and working_axes(window.angular_rate)[2]:
            from magcal_ros.core.methods.checks import check_window
            from magcal_ros.core.smoother.kinds_of_motion import expected_sigma

            check_window(window, knowledge)
            return expected_sigma(window, knowledge)
        estimate = find_method(method)(window, knowledge)
    except Refusal:
        return math.inf
    return predicted_heading_sigma(estimate, 0.0)
