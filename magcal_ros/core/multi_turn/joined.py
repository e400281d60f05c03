"""From turns that may meet to one joint optimum, the estimate and its figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import rms_sigma
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Belief, Knowledge
from magcal_ros.core.methods.smoother_one import estimate_of
from magcal_ros.core.multi_turn.observability import (
    advise,
    heading_jacobians,
    relative,
    shown_by,
    yaw_sigma,
)
from magcal_ros.core.multi_turn.result import Several, Shown, TurnFate
from magcal_ros.core.multi_turn.turn import Agreement, Turn, agreement
from magcal_ros.core.smoother.posterior import posterior
from magcal_ros.core.smoother.several import Together, fit_together
from magcal_ros.core.smoother.unknowns import TURNED

SHOWN_YAW = 0.5
"""Share of its prior's sigma below which the installation's yaw counts as shown."""
WORST_IS_LARGEST = (
    Figure.GYRO_COMPASS_SWING,
    Figure.STEADY_ACCELERATION,
    Figure.POSSIBLE_ACCELERATION,
    Figure.MOTOR_FIELD,
)
WORST_IS_SMALLEST = (Figure.GYRO_CARRIED, Figure.ON_THE_SPOT)
"""Figures of the turns' own fits of which the worst speaks for all."""


@dataclass(frozen=True, eq=False)
class Met:
    """Turns that agree."""

    together: Together
    """With the yaw of the installation free."""
    agreement: Agreement


def those_that_agree(turns: list[Turn], knowledge: Knowledge) -> tuple[list[Turn], Met | None]:
    """Leave out one turn after another until the rest shows one calibration.

    Returns
    -------
    list of Turn, Met or None
        All turns, those left out with the reason; the others together, None if there are none.
    """
    sigma = knowledge.mounting.yaw_sigma
    while members := [turn for turn in turns if not turn.unfit]:
        alone = [turn.fit for turn in members]
        try:
            together = fit_together(alone, sigma)
            found = agreement(alone, together, sigma)
        except np.linalg.LinAlgError:
            turns = _without(turns, members[-1], "it has no solution together with the others")
            continue
        if found.odd is None:
            return turns, Met(together, found)
        odd = members[found.odd]
        turns = _without(turns, odd, _contradiction(found.misfit, len(members)))
    return turns, None


def _without(turns: list[Turn], odd: Turn, words: str) -> list[Turn]:
    return [turn.left_out(words) if turn is odd else turn for turn in turns]


def _contradiction(misfit: float, count: int) -> str:
    others = "the other turns" if count > 2 else "the turn before"
    return (
        f"it contradicts {others}: they are {misfit:.0f} times as far apart as noise "
        "explains. Turn where the field is undisturbed and the same, with the same load; if the "
        "robot itself has changed, start afresh"
    )


def joint_estimate(met: Met, turns: Sequence[Turn], knowledge: Knowledge) -> Estimate:
    """Put a joint fit into the form that every method returns.

    Parameters
    ----------
    met : Met
    turns : sequence of Turn
        In the order of the fits. Inliers and residuals are those of the last.
    knowledge : Knowledge

    Returns
    -------
    Estimate
        `figures[Figure.HEADING_SIGMA]` and its tilted twin leave out the offset that all headings
        have in common, as one turn's do; `installation_yaw_sigma` is that offset's. Until the turns
        show the yaw it is zero by convention.
    """
    together, prior_sigma = met.together, knowledge.mounting.yaw_sigma
    is_shown = yaw_sigma(together.fits[-1].covariance) < SHOWN_YAW * prior_sigma
    if not is_shown:
        together = fit_together([turn.fit for turn in turns], 0.0)
    fit, own = together.fits[-1], turns[-1].own
    found = posterior(fit, knowledge.mounting.matrix)
    by_offset = rms_sigma(found.heading_jacobian, found.by_offset)
    joint = replace(
        own, fits={own.mode: fit}, weights={own.mode: 1.0}, posterior=found, by_pull=by_offset
    )
    estimate = estimate_of(joint, turns[-1].window, knowledge)
    level, tilted = heading_jacobians(found)
    counted = sum(int(turn.own_answer.inliers.sum()) for turn in turns)
    figures = {
        **estimate.figures,
        **_worst_of(turns),
        **_pulls(estimate, knowledge),
        Figure.HEADING_SIGMA: rms_sigma(relative(level, level), found.covariance),
        Figure.HEADING_SIGMA_TILTED: rms_sigma(relative(tilted, level), found.covariance),
        Figure.SAMPLES: float(counted),
        Figure.TURNS: float(len(turns)),
        Figure.TURN_MISFIT: met.agreement.misfit,
    }
    if is_shown:
        figures[Figure.INSTALLATION_YAW_SIGMA] = yaw_sigma(fit.covariance)
    arc = max(turn.own_answer.arc for turn in turns)
    words = "converged" if fit.converged else "did not converge"
    return replace(
        estimate, arc=arc, figures=figures, message=f"{len(turns)} turns {words} together"
    )


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


def _pulls(estimate: Estimate, knowledge: Knowledge) -> dict[Figure, float]:
    """Return by how many sigmas strength and inclination are off their beliefs."""
    reference = knowledge.reference
    pairs: tuple[tuple[Figure, float, Belief], ...] = (
        (Figure.STRENGTH_DEVIATION, estimate.strength, reference.strength),
        (Figure.INCLINATION_DEVIATION, estimate.inclination, reference.inclination),
    )
    return {
        figure: abs(value - belief.value) / belief.sigma
        for figure, value, belief in pairs
        if not belief.is_unknown and not belief.is_exact
    }


@dataclass(frozen=True, eq=False)
class Joined:
    """Turns put together."""

    turns: list[Turn]
    """All of them."""
    members: list[Turn]
    """Those that joined."""
    estimate: Estimate | None = None
    """Of two members or more; one stands by its own estimate."""
    several: Several | None = None
    """What became of each turn; None where none joined."""


def join(surveyed: list[Turn], knowledge: Knowledge) -> Joined:
    """Put together the turns that agree."""
    turns, met = those_that_agree(surveyed, knowledge)
    members = [turn for turn in turns if not turn.unfit]
    if met is None:
        return Joined(turns, members)
    together, mounting = met.together, knowledge.mounting.matrix
    shown = [_shown(together, count, mounting) for count in range(1, len(members) + 1)]
    # The turn that saw most is the one that is imagined on other tilts.
    whole = int(np.argmax([turn.own_answer.arc for turn in members]))
    advice = advise(_known(together, len(members)), together.fits[whole], mounting)
    several = Several(_fates(turns, shown), shown[-1], advice)
    estimate = joint_estimate(met, members, knowledge) if len(members) > 1 else None
    return Joined(turns, members, estimate, several)


def _known(together: Together, count: int) -> FloatArray:
    """Return what is known of the unknowns that all share, by the first turns and beforehand.

    The yaw of the installation stays zero by convention after one turn, whatever its sway shows.
    """
    known = np.asarray(together.prior + np.sum(together.informations[:count], axis=0))
    if count == 1:
        known[TURNED] = known[:, TURNED] = 0.0
        known[TURNED, TURNED] = together.prior[TURNED, TURNED]
    return known


def _shown(together: Together, count: int, mounting: FloatArray) -> Shown:
    """Return what the first `count` turns show at the joint optimum."""
    return shown_by(_known(together, count), together.fits[0], mounting)


def _fates(turns: list[Turn], shown: Sequence[Shown]) -> tuple[TurnFate, ...]:
    fates: list[TurnFate] = []
    count = 0
    for turn in turns:
        if turn.unfit:
            fates.append(TurnFate(turn.name, False, turn.unfit))
            continue
        now = shown[count]
        words = now.brought(shown[count - 1]) if count else now.in_words
        fates.append(TurnFate(turn.name, True, words, now))
        count += 1
    return tuple(fates)
