"""From the joint optimum to the package's own form: the estimate and its figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.calibration.estimate import Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import rms_sigma
from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.systematic_errors import systematic_covariance
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Knowledge, Systematics
from magcal_ros.core.methods.maximum_likelihood.diagnostics import pulls
from magcal_ros.core.methods.maximum_likelihood.report import EstimateParts, build_estimate
from magcal_ros.core.methods.maximum_likelihood.screening import seen_arc
from magcal_ros.core.multi_turn.fit import JointFit, those_that_agree
from magcal_ros.core.multi_turn.observability import (
    advise,
    heading_jacobians,
    relative,
    shown_by,
)
from magcal_ros.core.multi_turn.result import Several, Shown, TurnFate
from magcal_ros.core.multi_turn.turn import Turn

WORST_IS_LARGEST = (
    Figure.GYRO_COMPASS_SWING,
    Figure.FIELD_NOISE_RATIO,
    Figure.UP_NOISE,
    Figure.KAPPA,
    Figure.WOBBLE,
    Figure.STEADY_PULL,
    Figure.POSSIBLE_PULL,
    Figure.MOTOR_FIELD,
)
WORST_IS_SMALLEST = (Figure.INLIER_FRACTION, Figure.GYRO_CARRIED)
"""Figures of the turns' own fits of which the worst speaks for all."""


def joint_estimate(fit: JointFit, turns: Sequence[Turn], knowledge: Knowledge) -> Estimate:
    """Put a joint fit into the form that every method returns.

    Parameters
    ----------
    fit : JointFit
    turns : sequence of Turn
        In the order of the fit's blocks. Inliers and residuals are those of the last.
    knowledge : Knowledge

    Returns
    -------
    Estimate
        `figures[Figure.HEADING_SIGMA]` and its tilted twin leave out the offset that all headings
        have in common, as one turn's do; `installation_yaw_sigma` is that offset's.
    """
    last = turns[-1].own_fit
    prepared = [turn.own_fit.prepared for turn in turns]
    axis = last.choice.fit.shared.body_axis[:, 2]
    arc = max(seen_arc(turn.block) for turn in turns)
    covariance = fit.covariance + lasting_covariance(fit, turns, knowledge.systematics)
    figures = _figures(fit, turns, knowledge, covariance)
    return build_estimate(
        fit.best, EstimateParts(prepared, covariance, axis, arc, figures, last.swing)
    )


def lasting_covariance(
    fit: JointFit, turns: Sequence[Turn], systematics: Systematics
) -> FloatArray:
    """Return what errors that last add to the covariance of the twelve numbers, shape (12, 12).

    They are the sensors' and the robot's own, so turns do not average them out: the mean of what
    each turn alone would have.
    """
    each = []
    for turn in turns:
        axis = turn.block.place.state.shared.body_axis
        shared, own = replace(fit.best.shared, body_axis=axis), turn.own_fit
        seen, unseen = own.seen(systematics), own.unseen(systematics)
        mounting, scale = fit.best.mounting, fit.scale
        each.append(systematic_covariance(shared, mounting, scale, unseen, own.turning, seen))
    return np.asarray(np.mean(each, axis=0))


def _figures(
    fit: JointFit, turns: Sequence[Turn], knowledge: Knowledge, covariance: FloatArray
) -> dict[Figure, float]:
    best, scale = fit.best, fit.scale
    level, tilted = heading_jacobians(best.shared, best.mounting, scale)
    worst = max(fit.agreements, key=lambda agreement: -agreement.chance)
    figures = _worst_of(turns) | {
        Figure.HEADING_SIGMA: rms_sigma(relative(level, level), covariance),
        Figure.HEADING_SIGMA_TILTED: rms_sigma(relative(tilted, level), covariance),
        Figure.RESIDUAL_RATIO: _residual_ratio(fit),
        Figure.SAMPLES: float(sum(block.weighting.inliers.sum() for block in best.blocks)),
        Figure.SOFT_IRON: float(best.prior.has_soft_iron),
        Figure.SOFT_IRON_GAIN: fit.soft_iron_gain,
        Figure.FIELD_SCALE: scale,
        Figure.TURNS: float(len(turns)),
        Figure.TURN_MISFIT: worst.misfit,
    }
    if fit.shows_yaw:
        sigma = math.sqrt(fit.widening * float(best.covariance[p.YAW, p.YAW]))
        figures[Figure.INSTALLATION_YAW_SIGMA] = math.hypot(sigma, knowledge.systematics.axes)
    return figures | pulls(best.shared, knowledge.reference, scale)


def _worst_of(turns: Sequence[Turn]) -> dict[Figure, float]:
    """Return the worst of the turns' own figures, of those that could stand alone."""
    own = [turn.estimate.figures for turn in turns if turn.estimate is not None]
    figures: dict[Figure, float] = {}
    for names, worst in ((WORST_IS_LARGEST, max), (WORST_IS_SMALLEST, min)):
        for name in names:
            values = [each[name] for each in own if name in each]
            if values:
                figures[name] = worst(values)
    return figures


def _residual_ratio(fit: JointFit) -> float:
    """Return the RMS residual of the inliers of all turns over the level field."""
    shared = fit.best.shared
    squares = [
        block.place.prediction.field_residual[block.weighting.inliers] ** 2
        for block in fit.best.blocks
    ]
    level = abs(shared.strength * math.cos(shared.inclination))
    return math.sqrt(float(np.mean(np.vstack(squares)))) / level


@dataclass(frozen=True, eq=False)
class Joined:
    """Turns put together.

    Parameters
    ----------
    turns : list of Turn
        All of them.
    members : list of Turn
        Those that joined.
    estimate : Estimate or None
        Of two members or more; one stands by its own estimate.
    several : Several or None
        What became of each turn; None where none joined.
    """

    turns: list[Turn]
    members: list[Turn]
    estimate: Estimate | None = None
    several: Several | None = None


def join(surveyed: list[Turn], knowledge: Knowledge) -> Joined:
    """Put together the turns that agree."""
    turns, fit = those_that_agree(surveyed, knowledge)
    members = [turn for turn in turns if not turn.unfit]
    if fit is None:
        return Joined(turns, members)
    several = Several(_fates(turns, fit), _shown(fit), advise(fit.meeting, fit.scale))
    estimate = joint_estimate(fit, members, knowledge) if len(members) > 1 else None
    return Joined(turns, members, estimate, several)


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
