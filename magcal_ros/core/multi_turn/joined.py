"""Several turns joined: one optimum, what it shows, and what one more turn would add."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.calibration import PARAMETERS, Estimate, Figure
from magcal_ros.core.calibration.heading_sigma import CHECKED_TILT, heading_jacobian, rms_sigma
from magcal_ros.core.geometry import FloatArray, field_in_enu, minimal_rotation, rotation_from_rpy
from magcal_ros.core.knowledge import Belief, Knowledge
from magcal_ros.core.methods.maximum_likelihood import estimate_of
from magcal_ros.core.multi_turn.result import Advice, Several, Shown, TurnFate
from magcal_ros.core.multi_turn.turn import Agreement, Turn, agreement
from magcal_ros.core.smoother.fit import Fit
from magcal_ros.core.smoother.posterior import Posterior, posterior, posterior_at
from magcal_ros.core.smoother.several import Together, fit_together, imagined_information
from magcal_ros.core.smoother.unknowns import (
    EARTH,
    MICROTESLA,
    SHARED,
    SHIELDING,
    SYMMETRIC,
    TURNED,
    YAW,
)

Z: FloatArray = np.array([0.0, 0.0, 1.0])

SLOPES = (("east", 0.0), ("north", 0.5 * math.pi), ("west", math.pi), ("south", 1.5 * math.pi))
LEANINGS = (
    ("the nose 10° up", (0.0, -CHECKED_TILT)),
    ("the nose 10° down", (0.0, CHECKED_TILT)),
    ("the left side 10° up", (CHECKED_TILT, 0.0)),
    ("the right side 10° up", (-CHECKED_TILT, 0.0)),
)


def heading_jacobians(found: Posterior) -> tuple[FloatArray, FloatArray]:
    """Return the derivative of the yaw by the twelve numbers: level (24, 12), tilted (96, 12)."""
    field = field_in_enu(found.strength, found.inclination)
    level, tilted = (
        heading_jacobian(found.correction, field, tilt) for tilt in (0.0, CHECKED_TILT)
    )
    return level, tilted


def relative(jacobian: FloatArray, level: FloatArray) -> FloatArray:
    """Return the Jacobian of the yaw after the level's common offset is taken off."""
    return np.asarray(jacobian - level.mean(axis=0))


def yaw_sigma(covariance: FloatArray) -> float:
    """Return the standard deviation of the installation's yaw, by a covariance (SHARED, SHARED)."""
    rows = [YAW, TURNED]
    return math.sqrt(float(covariance[np.ix_(rows, rows)].sum()))


def shown_by(information: FloatArray, fit: Fit, mounting: FloatArray) -> Shown:
    """Return the standard deviations that an information matrix (SHARED, SHARED) implies at a fit.

    It includes the priors. `mounting` (3, 3) is from nominal body axes to sensor axes.
    """
    covariance = _inverse(information)
    found = posterior_at(fit.state, covariance, mounting)
    twelve = found.covariance
    level, tilted = heading_jacobians(found)
    axial = np.zeros(PARAMETERS)
    axial[9:] = np.linalg.solve(mounting, np.eye(3))[2]
    iron = np.zeros((6, SHARED))
    for part in SYMMETRIC:
        iron[:, part] = np.eye(6)
    iron[:2, SHIELDING] = 1.0
    north, down = fit.state.earth[1], -fit.state.earth[2]
    strength = math.hypot(north, down)
    along = np.array([north, down]) / strength
    earth = covariance[EARTH, EARTH]
    across = np.array([-along[1], along[0]]) / strength
    return Shown(
        installation_yaw=yaw_sigma(covariance),
        soft_iron=tuple(float(v) for v in np.sqrt(np.diag(iron @ covariance @ iron.T))),
        axial_hard_iron=math.sqrt(max(float(axial @ twelve @ axial), 0.0)),
        strength=math.sqrt(float(along @ earth @ along)) / MICROTESLA,
        inclination=math.sqrt(float(across @ earth @ across)),
        level=rms_sigma(relative(level, level), twelve),
        tilted=rms_sigma(relative(tilted, level), twelve),
        absolute_level=rms_sigma(level, twelve),
        absolute_tilted=rms_sigma(tilted, twelve),
    )


def _inverse(information: FloatArray) -> FloatArray:
    known = np.flatnonzero(np.diag(information) > 0.0)
    size = 1.0 / np.sqrt(np.diag(information)[known])
    scaled = information[np.ix_(known, known)] * np.outer(size, size)
    out = np.zeros_like(information)
    out[np.ix_(known, known)] = np.linalg.inv(scaled) * np.outer(size, size)
    return out


def advise(information: FloatArray, fit: Fit, mounting: FloatArray) -> tuple[Advice, ...]:
    """Return further turns, the one first that leaves the smallest absolute heading error.

    Each is imagined as the turn of `fit` about another axis; its expected information is added to
    what there is. `information` (SHARED, SHARED) includes the priors.
    """
    # What all attitudes keep is the axis of the turn, in the body and in the world.
    inside, _, outside = np.linalg.svd(fit.state.attitude.mean(axis=0))
    axis, up = (math.copysign(1.0, outside[0, 2]) * each for each in (inside[:, 0], outside[0]))

    def after(body: FloatArray, world: FloatArray) -> Shown:
        turned = minimal_rotation(axis, body), minimal_rotation(world, up)
        return shown_by(information + imagined_information(fit, *turned), fit, mounting)

    imagined = [Advice(pose, after(*each)) for pose, *each in _poses()]
    return tuple(sorted(imagined, key=lambda advice: advice.after.absolute_tilted))


def _poses() -> list[tuple[str, FloatArray, FloatArray]]:
    """Return what to do, and the turn's axis in the body and in the world."""
    poses = [("on the level once more", Z, Z)]
    for name, azimuth in SLOPES:
        lean = math.sin(CHECKED_TILT)
        normal = [-lean * math.cos(azimuth), -lean * math.sin(azimuth), math.cos(CHECKED_TILT)]
        poses.append((f"on a slope of 10° that rises to the {name}", Z, np.array(normal)))
    for name, (roll, pitch) in LEANINGS:
        poses.append((f"about the vertical with {name}", rotation_from_rpy(roll, pitch).T @ Z, Z))
    return poses


SHOWN_YAW = 0.5
"""Share of its prior's sigma below which the installation's yaw counts as shown."""
WORST_IS_LARGEST = (
    Figure.GYRO_COMPASS_SWING,
    Figure.STEADY_ACCELERATION,
    Figure.POSSIBLE_ACCELERATION,
    Figure.MOTOR_FIELD,
)
WORST_IS_SMALLEST = (Figure.GYRO_CARRIED, Figure.ON_THE_SPOT)
"""Figures of the turns' own fits of which the worst is reported."""


@dataclass(frozen=True, eq=False)
class Met:
    """Turns that agree."""

    together: Together
    """With the yaw of the installation free."""
    agreement: Agreement


def those_that_agree(turns: list[Turn], knowledge: Knowledge) -> tuple[list[Turn], Met | None]:
    """Leave out one turn after another until the rest agrees on one calibration.

    Returns all turns, those left out with the reason, and the joint fit of the others; None if none
    is left.
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
    """Return a joint fit in the form that every method returns.

    The turns are in the order of the fits; inliers and residuals are those of the last.
    `Figure.HEADING_SIGMA` and its tilted twin leave out the offset that all headings have in
    common, as for one turn; `installation_yaw_sigma` is that of the offset. The yaw is zero by
    convention until the turns show it.
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
    members: list[Turn]
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
