"""From several windows to one judged calibration, and to what the next turn should be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magcal_ros.core.calibrate import JOINS, Outcome, calibrate, judged
from magcal_ros.core.errors import Misuse, Reason, Refusal
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.several.agreement import Agreement, agreements
from magcal_ros.core.several.conclude import joint_estimate
from magcal_ros.core.several.fit import JointFit, fit_jointly, meet, odd_one
from magcal_ros.core.several.joint import Joint
from magcal_ros.core.several.observability import advise, shown_by
from magcal_ros.core.several.result import Several, Shown, TurnFate
from magcal_ros.core.several.survey import Turn, survey
from magcal_ros.core.window import Window

POOL = ("ellipsoid", "min_max")
"""Methods that take all samples for one tumble."""

FEWEST_BELIEVED = 0.4
"""Share of a turn's samples that the joint fit must believe."""
PAUSE = 1.0
"""Seconds between turns whose samples are pooled."""


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
        the reason, and the rest stands. One turn alone gives what `calibrate` gives.

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
    turns = survey(windows, called, knowledge)
    members, fit = _those_that_agree(turns, knowledge)
    return _outcome(members, fit, knowledge)


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


def _those_that_agree(
    turns: list[Turn], knowledge: Knowledge
) -> tuple[list[Turn], JointFit | None]:
    """Leave out one turn after another until the rest tells one calibration."""
    while True:
        fit_for = [turn for turn in turns if not turn.unfit]
        if not fit_for:
            return turns, None
        scale = _scale(fit_for)
        blocks = [turn.block for turn in fit_for]
        joint = meet(blocks, knowledge, scale)
        found = agreements(joint)
        if len(blocks) > 1 and any(agreement.is_broken for agreement in found):
            odd = odd_one(blocks, joint.prior)
            turns = _without(turns, fit_for[odd], _contradiction(found[odd], len(blocks)))
            continue
        fit = fit_jointly(blocks, knowledge, scale)
        doubtful = _disbelieved(fit.joint) if len(blocks) > 1 else None
        if doubtful is None:
            return turns, fit
        turns = _without(turns, fit_for[doubtful], "most of its samples contradict the other turns")


def _scale(turns: list[Turn]) -> float:
    solved = turns[0].solved
    assert solved is not None
    return solved.prepared.scale


def _disbelieved(joint: Joint) -> int | None:
    shares = [float(block.problem.weights.sample.mean()) for block in joint.blocks]
    worst = int(np.argmin(shares))
    return worst if shares[worst] < FEWEST_BELIEVED else None


def _without(turns: list[Turn], odd: Turn, words: str) -> list[Turn]:
    return [turn.left_out(words) if turn is odd else turn for turn in turns]


def _contradiction(agreement: Agreement, count: int) -> str:
    others = "the other turns" if count > 2 else "the turn before"
    return (
        f"it contradicts {others}: they are {agreement.misfit:.0f} times as far apart as noise "
        "explains. Turn where the field is undisturbed and the same, with the same load; if the "
        "robot itself has changed, start afresh"
    )


def _outcome(turns: list[Turn], fit: JointFit | None, knowledge: Knowledge) -> Outcome:
    if fit is None:
        return turns[0].outcome if len(turns) == 1 else _none_of(turns)
    joined = [turn for turn in turns if not turn.unfit]
    several = Several(_fates(turns, fit), _shown(fit), advise(fit.meeting, fit.scale))
    if len(joined) == 1:
        return replace(joined[0].outcome, several=several)
    estimate = joint_estimate(fit, joined, knowledge)
    return replace(judged(estimate, knowledge, joined[-1].window), several=several)


def _none_of(turns: list[Turn]) -> Outcome:
    words = "; ".join(f"{turn.name}: {turn.unfit}" for turn in turns)
    reason = turns[-1].outcome.reason or Reason.NO_SOLUTION
    return Outcome.refused(Refusal(reason, f"none of the turns can be used: {words}"))


def _shown(fit: JointFit, count: int | None = None) -> Shown:
    """Return what the first `count` turns show at the joint optimum; all unless given."""
    joint, parts = fit.meeting, fit.meeting.turn_information[:count]
    information = sum(parts, joint.prior_information) / fit.widening
    return shown_by(information, joint.free, joint.shared, joint.mounting, fit.scale)


def _fates(turns: list[Turn], fit: JointFit) -> tuple[TurnFate, ...]:
    fates: list[TurnFate] = []
    before, count = None, 0
    for turn in turns:
        if turn.unfit:
            fates.append(TurnFate(turn.name, False, turn.unfit))
            continue
        count += 1
        shown = _shown(fit, count)
        words = shown.in_words if before is None else shown.brought(before)
        fates.append(TurnFate(turn.name, True, words, shown))
        before = shown
    return tuple(fates)
