"""From a window, or several, to a judged calibration: the way that node and command line go."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, cast

import numpy as np

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.assessment.verdict import Verdict, judge, refuse
from magcal_ros.core.calibration.calibration import Calibration, Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import predicted_heading_sigma
from magcal_ros.core.errors import Misuse, Reason, Refusal
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.multi_turn.result import Kept, Several
from magcal_ros.core.samples.window import Window

if TYPE_CHECKING:
    from magcal_ros.core.samples.drive_log import DriveLog

# What only a fit needs is imported by the functions that fit: a node that starts on a saved
# calibration would wait for it before its first message.

Fit = Callable[[Window, Knowledge], Estimate]

METHODS = ("maximum_likelihood", "smoother", "smoother_one", "design_tip", "ellipsoid", "min_max")
"""Names that `find_method` knows, the recommended one first."""
DRIVES = METHODS[1]
"""The method that takes a drive without a turn."""
ONE_SMOOTHER = METHODS[0], METHODS[2]
"""Two names of one method (doc/smoother.md)."""
METHOD_WORDS = (
    f"How a turn is turned into a calibration. {METHODS[0]}, also named {METHODS[2]}, is right for "
    f"turns and drives; {DRIVES} takes a turn for a drive; the others are for comparison"
)
JOINS = METHODS[0]
"""The method that joins turns."""
POOL = ("ellipsoid", "min_max")
"""Methods that take all samples for one tumble."""
PAUSE = 1.0
"""Seconds between turns whose samples are pooled."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of a window.

    Parameters
    ----------
    verdict : Verdict
        How it is judged.
    calibration : Calibration or None
        What was found, whatever the verdict; None if nothing could be found.
    estimate : Estimate or None
        The method's own result.
    reason : Reason or None
        Why nothing could be found.
    several : Several or None
        Where turns were put together: what became of each, what is shown, and what comes next.
    window : Window or None
        The samples that were looked at: the estimate's residuals are of its rows.
    """

    verdict: Verdict
    calibration: Calibration | None = None
    estimate: Estimate | None = None
    reason: Reason | None = None
    several: Several | None = None
    window: Window | None = None

    @classmethod
    def refused(cls, refusal: Refusal, window: Window | None = None) -> Outcome:
        """Return what comes of samples that cannot carry a calibration."""
        return cls(refuse(refusal), reason=refusal.reason, window=window)


def find_method(name: str) -> Fit:
    """Return the method of a name, imported when it is asked for.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    if name not in METHODS:
        raise ValueError(f"there is no method {name!r}; choose one of {', '.join(METHODS)}")
    name = METHODS[0] if name in ONE_SMOOTHER else name
    module = importlib.import_module(f"magcal_ros.core.methods.{name}")
    return cast("Fit", module.fit)


def calibrate(
    window: Window,
    knowledge: Knowledge,
    method: str = METHODS[0],
    told: Callable[[float], object] | None = None,
) -> Outcome:
    """Fit a window as a turn, or as the drive that it was, and judge the result.

    Parameters
    ----------
    window : Window
        The samples of one turn.
    knowledge : Knowledge
        What is known beforehand.
    method : str
        One of `METHODS`. By the first the smoother answers, with a gyro or without, whether the
        robot turned on the spot or drove.
    told : callable, optional
        Takes the share of the work that is done, 0 to 1, of a fit that takes long.

    Returns
    -------
    Outcome
        Never raises for bad data: a refusal is a verdict.
    """
    from magcal_ros.core.doctor.page import blamed_on_axes, wrong_reading

    wrong = wrong_reading(window, knowledge)
    if wrong is not None:
        return Outcome.refused(wrong, window)
    fit = find_method(method)
    if told is not None and method in ONE_SMOOTHER:
        fit = partial(cast("Callable[..., Estimate]", fit), told=told)
    try:
        estimate = fit(window, knowledge)
    except Refusal as refusal:
        return Outcome.refused(blamed_on_axes(refusal, window, knowledge), window)
    return _judged_by_axes_too(estimate, knowledge, window)


def _judged_by_axes_too(estimate: Estimate, knowledge: Knowledge, window: Window) -> Outcome:
    """Judge an estimate unless the samples say that axes or stamps are wrong.

    Looking for wrong axes takes time, and with them the smoother's sigma is not good. A z axis that
    points down explains the rest.
    """
    from magcal_ros.core.doctor.page import wrong_axes, wrong_stamps

    outcome = judged(estimate, knowledge, window)
    explains = outcome.verdict.accepted and estimate.figures.get(Figure.GYRO_CARRIED, 1.0) > 0.0
    if explains and outcome.verdict.is_good and estimate.method in (JOINS, DRIVES):
        return outcome
    refused = {each.figure for each in outcome.verdict.checks if each.grade is Grade.REFUSED}
    if Figure.AXIS_LEAN in refused:
        return outcome
    wrong = wrong_axes(window, knowledge) or (None if explains else wrong_stamps(window))
    return outcome if wrong is None else Outcome.refused(wrong, window)


def judged(estimate: Estimate, knowledge: Knowledge, window: Window | None = None) -> Outcome:
    """Judge an estimate; `window` holds the samples that its residuals are of, if of any."""
    verdict = judge(estimate, knowledge, window)
    calibration = Calibration.from_estimate(estimate, verdict.evidence(estimate))
    return Outcome(verdict, calibration, estimate, window=window)


def calibrate_drive(log: DriveLog, knowledge: Knowledge) -> Outcome:
    """Fit the log of a drive and judge the result; its samples are the rows of the log."""
    from magcal_ros.core.doctor.page import wrong_reading
    from magcal_ros.core.methods.smoother import fit_log

    if not len(log):
        words = "nothing was driven: no samples with a gyro in which the robot moved"
        return Outcome.refused(Refusal(Reason.TOO_FEW_SAMPLES, words))
    window = log.window
    wrong = wrong_reading(window, knowledge)
    if wrong is not None:
        return Outcome.refused(wrong, window)
    try:
        estimate = fit_log(log, knowledge)
    except Refusal as refusal:
        return Outcome.refused(refusal, window)
    return _judged_by_axes_too(estimate, knowledge, window)


def calibrate_turns(
    windows: Sequence[Window],
    knowledge: Knowledge,
    method: str = JOINS,
    names: Sequence[str] | None = None,
) -> Outcome:
    """Join turns into one estimate and judge it.

    Parameters
    ----------
    windows : sequence of Window
        One for each turn; at least one.
    knowledge : Knowledge
        What is known beforehand, of all turns alike: they are made in one place.
    method : str
        `maximum_likelihood` joins turns; `ellipsoid` and `min_max` take their samples as one
        tumble.
    names : sequence of str, optional
        What to call the turns.

    Returns
    -------
    Outcome
        Never raises for bad data. A turn that does not belong to the others is left out, with
        the reason, and the rest stands. One turn alone gives what `calibrate` makes of a turn.

    Raises
    ------
    Misuse
        If the method can make nothing of several turns.
    """
    called = [f"turn {k + 1}" for k in range(len(windows))] if names is None else names
    if method in POOL:
        return calibrate(pooled(windows), knowledge, method)
    if method != JOINS:
        if len(windows) > 1:
            raise Misuse(f"the method {method} takes one turn; {JOINS} joins several")
        return calibrate(windows[0], knowledge, method)
    from magcal_ros.core.multi_turn.joined import join, survey

    turns, joint, several = join(survey(windows, called, knowledge), knowledge)
    members = [turn for turn in turns if not turn.unfit]
    turn = (members or turns)[-1]
    if joint is not None:
        outcome = judged(joint, knowledge, turn.window)
    elif turn.unfit and len(turns) > 1:
        each = "; ".join(f"{turn.name}: {turn.unfit}" for turn in turns)
        words = f"none of the turns can be used: {each}"
        outcome = Outcome.refused(Refusal(turn.reason or Reason.NO_SOLUTION, words), turn.window)
    elif turn.estimate is not None and turn.reason is None:
        outcome = _judged_by_axes_too(turn.estimate, knowledge, turn.window)
    else:
        outcome = calibrate(turn.window, knowledge)
    return replace(outcome, several=several)


def pooled(windows: Sequence[Window]) -> Window:
    """Put the samples of several windows one after another, with a short pause between."""
    times, end = [], 0.0
    for window in windows:
        times.append(window.time - window.time[0] + end)
        end = float(times[-1][-1]) + PAUSE
    rates = [window.angular_rate for window in windows]
    known = [rate for rate in rates if rate is not None]
    return Window(
        np.concatenate(times) + windows[0].time[0],
        np.vstack([window.field for window in windows]),
        np.vstack([window.specific_force for window in windows]),
        np.vstack(known) if len(known) == len(rates) else None,
    )


def take_turn(
    kept: Kept,
    window: Window,
    knowledge: Knowledge,
    method: str,
    accumulate: bool,
) -> tuple[Outcome, Kept]:
    """Fit a turn, together with those that are kept if turns are accumulated.

    Parameters
    ----------
    kept : Kept
        The turns before.
    window : Window
        The new turn.
    knowledge : Knowledge
        Of this moment; it holds for the turns before too.
    method : str
        Name of the method; only `maximum_likelihood` accumulates.
    accumulate : bool
        Whether turns are put together; such a turn is never fitted as a drive.

    Returns
    -------
    Outcome, Kept
        A turn that is refused does not join: the others stay as they are.
    """
    if not accumulate:
        return calibrate(window, knowledge, method), Kept()
    names = (*kept.names, kept.next_name)
    outcome = calibrate_turns([*kept.windows, window], knowledge, method, names)
    several = outcome.several
    if several is None or not several.fates[-1].joined:
        return _refused(outcome, kept), kept
    return outcome, kept.joined(window, several) if outcome.verdict.accepted else kept


def _refused(outcome: Outcome, kept: Kept) -> Outcome:
    """Say why the new turn did not join; what the turns before show is no news."""
    if not kept.windows:
        return outcome
    why = outcome.verdict.summary if outcome.several is None else outcome.several.fates[-1].words
    count = len(kept.windows)
    words = (
        f"{kept.next_name} does not join the {'turn' if count == 1 else f'{count} turns'} before "
        f"it: {why.rstrip('.')}; those before stay"
    )
    refusal = Refusal(outcome.reason or Reason.TURNS_DISAGREE, words)
    return replace(Outcome.refused(refusal), several=outcome.several)


def predicted_sigma(window: Window, knowledge: Knowledge, method: str = METHODS[0]) -> float:
    """Return the heading sigma on the level that a fit of this window would have, radians.

    Infinite where there is no fit.
    """
    from magcal_ros.core.smoother.without_gyro import living_axes

    try:
        if method in ONE_SMOOTHER and living_axes(window.angular_rate)[2]:
            from magcal_ros.core.methods.checks import check_window
            from magcal_ros.core.smoother.kinds_of_motion import promised_sigma

            check_window(window, knowledge)
            return promised_sigma(window, knowledge)
        estimate = find_method(method)(window, knowledge)
    except Refusal:
        return math.inf
    return predicted_heading_sigma(estimate, 0.0)
