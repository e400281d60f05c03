"""Several turns joined: which agree, what they determine, and what one more turn would add.

Whether a turn has the same calibration as the others is a test of two hypotheses: one calibration
for all turns, or one for the turn and another for the rest. Both are fitted, each with separate
noise sizes. The difference of their evidences is twice the log likelihood ratio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.assessment.verdict import judge
from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.calibration.correction import PARAMETERS
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import CHECKED_TILT, heading_jacobian, rms_sigma
from magcal_ros.core.doctor.sensor_report import refusal_by_axes, wrong_axes
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import field_in_enu
from magcal_ros.core.geometry.rotations import in_axes, minimal_rotation, rotation_from_rpy
from magcal_ros.core.knowledge import Knowledge, Z, level_rotation
from magcal_ros.core.methods.smoother import check, estimate_of, smoothed
from magcal_ros.core.multi_turn.result import MultiTurnReport, TurnAccuracy, TurnAdvice, TurnResult
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.fit import Fit
from magcal_ros.core.smoother.joint_fit import JointFit, fit_jointly, imagined_information
from magcal_ros.core.smoother.kinds_of_motion import Smoothed
from magcal_ros.core.smoother.posterior import Posterior, posterior, posterior_at
from magcal_ros.core.smoother.unknowns import (
    AT,
    EARTH,
    MICROTESLA,
    SHARED,
    SHIELDING,
    TURNED,
    YAW,
)

COMPARED_ABOVE = 2.0  # misfit below which turns are not compared further; this only saves time
LEAST_DIFFERENCE = 0.03  # least relative difference of the two variances in the Hausman test
COPY_SHARE = 0.5  # fraction of common samples from which a turn is a copy of another
SHOWN_YAW = 0.5  # ratio of posterior to prior sigma below which the installation's yaw is published
JOINABLE = (Reason.ARC_TOO_SHORT, Reason.AMBIGUOUS)
"""Reasons for which a turn is not enough alone, but may be joined with others."""
ALSO_JOINABLE = (Reason.CIRCLE_TOO_SMALL, Reason.AXIS_ALONG_FIELD, Reason.FIELD_TOO_STEEP)
"""The same without a reference: one turn does not determine the dip of the field."""
WORST_IS_LARGEST = (
    Figure.GYRO_COMPASS_SWING,
    Figure.STEADY_ACCELERATION,
    Figure.POSSIBLE_ACCELERATION,
    Figure.MOTOR_FIELD,
    Figure.IRON_DRIFT,
)
WORST_IS_SMALLEST = (Figure.GYRO_CARRIED, Figure.ON_THE_SPOT)
"""Figures of the separate fits whose worst value is reported."""
CONTRADICTS = (
    "it contradicts {}: their hard irons differ by {:.0f} sigmas. Turn where the field is "
    "undisturbed and the same, with the same load; if the robot itself has changed, start over"
)
SIDES = (
    ("east", "the nose 10° down", (0.0, CHECKED_TILT)),
    ("north", "the right side 10° up", (-CHECKED_TILT, 0.0)),
    ("west", "the nose 10° up", (0.0, -CHECKED_TILT)),
    ("south", "the left side 10° up", (CHECKED_TILT, 0.0)),
)
"""Where a slope rises to; how a robot is tilted; roll and pitch (rad) of this tilt."""


@dataclass(frozen=True, eq=False)
class Turn:
    """One turn with its estimate and fits, None if there are none.

    `reason` is why the turn is not enough alone, `refusal_words` why it cannot join; empty if it
    can.
    """

    name: str
    window: Window  # in level axes, as the estimate is
    estimate: Estimate | None
    smoothed: Smoothed | None
    reason: Reason | None = None
    refusal_words: str = ""

    @property
    def found(self) -> tuple[Estimate, Smoothed]:
        """The estimate and the fits of a turn that may join."""
        assert self.estimate is not None
        assert self.smoothed is not None
        return self.estimate, self.smoothed

    @property
    def fit(self) -> Fit:
        """The fit of the most likely kind of motion."""
        return self.found[1].fit


def fit_turns(windows: Sequence[Window], names: Sequence[str], knowledge: Knowledge) -> list[Turn]:
    """Fit each turn alone, and note why it cannot join."""
    turns: list[Turn] = []
    for window, name in zip(windows, names, strict=True):
        turn = _single_turn(window, name, knowledge)
        twin = next((t for t in turns if _is_copy(turn.window, t.window)), None)
        if twin is not None:
            turn = replace(turn, refusal_words=f"it holds the same samples as {twin.name}")
        turns.append(turn)
    return turns


def _single_turn(window: Window, name: str, knowledge: Knowledge) -> Turn:
    found = estimate = None
    level, known = in_axes((window, knowledge), level_rotation(knowledge.upward))
    try:
        found = smoothed(level, known)
        estimate = estimate_of(found, level, known)
        check(found, estimate, level, known)
    except Refusal as refusal:
        why = refusal_by_axes(refusal, window, knowledge)
        reference = knowledge.reference
        guessed = reference.strength.is_unknown and reference.inclination.is_unknown
        mended = estimate is not None and refusal.reason in JOINABLE + ALSO_JOINABLE * guessed
        refusal_words = "" if mended else str(why).rstrip(".")
        return Turn(name, level, estimate, found, why.reason, refusal_words)
    wrong = wrong_axes(window, knowledge)
    if wrong is not None:
        return Turn(name, level, estimate, found, wrong.reason, str(wrong))
    verdict = judge(estimate, known, level)
    refusal_words = verdict.summary.rstrip(".") if verdict.quality is Grade.REFUSED else ""
    return Turn(name, level, estimate, found, refusal_words=refusal_words)


def _is_copy(window: Window, other: Window) -> bool:
    """Return whether most samples of the shorter window are in the other; stamps may differ."""
    one, two = (
        {row.tobytes() for row in np.hstack([each.field, each.specific_force])}
        for each in (window, other)
    )
    return len(one & two) > COPY_SHARE * min(len(one), len(two))


def _gain(alone: Sequence[Fit], odd: int, joint_fit: JointFit, yaw_sigma: float) -> float:
    """Return twice the log likelihood ratio of a separate calibration for one turn."""
    rest = fit_jointly([each for k, each in enumerate(alone) if k != odd], yaw_sigma)
    own = fit_jointly([alone[odd]], yaw_sigma)
    return joint_fit.evidence - rest.evidence - own.evidence


def _misfit(alone: Fit, joint: Fit) -> float:
    """Return the RMS difference of hard iron, normalised by its sigmas.

    The joint estimate is efficient: the variance of the difference is the difference of the
    variances (Hausman, Econometrica 46, 1978).
    """
    iron = AT["iron"]
    values, vectors = np.linalg.eigh(alone.covariance[iron, iron])
    whiten = vectors / np.sqrt(np.maximum(values, 1e-12))
    shares, turned = np.linalg.eigh(whiten.T @ joint.covariance[iron, iron] @ whiten)
    off = turned.T @ whiten.T @ (alone.state.shared - joint.state.shared)[iron]
    return float(np.sqrt(np.mean(off**2 / np.maximum(1.0 - shares, LEAST_DIFFERENCE))))


def joint_estimate(
    joint_fit: JointFit, misfit: float, turns: Sequence[Turn], knowledge: Knowledge
) -> Estimate:
    """Return the estimate of a joint fit.

    The turns are in the order of the fits; inliers and residuals are those of the last.
    `Figure.HEADING_SIGMA` and `HEADING_SIGMA_TILTED` do not include the offset common to all
    headings, as for one turn; its sigma is `installation_yaw_sigma`. The yaw is zero by convention
    until the turns determine it.
    """
    prior_sigma = knowledge.mounting.yaw_sigma
    is_shown = yaw_sigma(joint_fit.fits[-1].covariance) < SHOWN_YAW * prior_sigma
    if not is_shown:
        joint_fit = fit_jointly([turn.fit for turn in turns], 0.0)
    fit, (_, own) = joint_fit.fits[-1], turns[-1].found
    found = posterior(fit, knowledge.mounting.matrix)
    offset = rms_sigma(found.heading_jacobian, found.by_offset)
    joint = replace(
        own, fits={own.mode: fit}, weights={own.mode: 1.0}, posterior=found, by_acceleration=offset
    )
    estimate = estimate_of(joint, turns[-1].window, knowledge)
    answers = [turn.found[0] for turn in turns]
    _, _, level, tilted = heading_sigmas(found)
    figures = {
        **estimate.figures,
        **_worst_of(turns),
        **_deviations(estimate, knowledge),
        Figure.HEADING_SIGMA: level,
        Figure.HEADING_SIGMA_TILTED: tilted,
        Figure.SAMPLES: float(sum(each.inliers.sum() for each in answers)),
        Figure.TURNS: float(len(turns)),
        Figure.TURN_MISFIT: misfit,
    }
    if is_shown:
        figures[Figure.INSTALLATION_YAW_SIGMA] = yaw_sigma(fit.covariance)
    arc = max(each.arc for each in answers)
    words = f"{len(turns)} turns {'converged' if fit.converged else 'did not converge'} together"
    return replace(estimate, arc=arc, figures=figures, message=words, gyro=None)


def _worst_of(turns: Sequence[Turn]) -> dict[Figure, float]:
    """Return the worst figures of the separate fits, of turns that are enough alone."""
    own = [turn.found[0].figures for turn in turns if turn.reason is None]
    figures: dict[Figure, float] = {}
    for names, worst in ((WORST_IS_LARGEST, max), (WORST_IS_SMALLEST, min)):
        for name in names:
            if values := [each[name] for each in own if name in each]:
                figures[name] = worst(values)
    return figures


def _deviations(estimate: Estimate, knowledge: Knowledge) -> dict[Figure, float]:
    """Return the normalised differences of strength and inclination from the reference."""
    known = knowledge.reference
    pairs = (
        (Figure.STRENGTH_DEVIATION, estimate.strength, known.strength),
        (Figure.INCLINATION_DEVIATION, estimate.inclination, known.inclination),
    )
    return {
        figure: abs(value - belief.value) / belief.sigma
        for figure, value, belief in pairs
        if not belief.is_unknown and not belief.is_exact
    }


def heading_sigmas(found: Posterior) -> tuple[float, ...]:
    """Return the yaw's sigma on the level and tilted, and both without the level's mean offset."""
    field = field_in_enu(found.strength, found.inclination)
    level, tilted = (
        heading_jacobian(found.correction, field, tilt) for tilt in (0.0, CHECKED_TILT)
    )
    offset = level.mean(axis=0)
    each = (level, tilted, level - offset, tilted - offset)
    return tuple(rms_sigma(jacobian, found.covariance) for jacobian in each)


def yaw_sigma(covariance: FloatArray) -> float:
    """Return the standard deviation of the installation's yaw, by a covariance (SHARED, SHARED)."""
    rows = [YAW, TURNED]
    return math.sqrt(float(covariance[np.ix_(rows, rows)].sum()))


def accuracy_by(information: FloatArray, fit: Fit, mounting: FloatArray) -> TurnAccuracy:
    """Return the standard deviations that an information matrix (SHARED, SHARED) implies at a fit.

    It includes the priors. `mounting` (3, 3) is from nominal body axes to sensor axes.
    """
    covariance = _inverse(information)
    found = posterior_at(fit.state, covariance, mounting)
    absolute_level, absolute_tilted, level, tilted = heading_sigmas(found)
    axial = np.zeros(PARAMETERS)
    axial[9:] = np.linalg.solve(mounting, np.eye(3))[2]
    iron = np.zeros((6, SHARED))
    iron[:, AT["soft_iron"]] = np.eye(6)
    iron[:2, SHIELDING] = 1.0
    along = np.array([math.cos(found.inclination), math.sin(found.inclination)])
    across = np.array([-along[1], along[0]]) / (found.strength * MICROTESLA)
    earth = covariance[EARTH, EARTH]
    return TurnAccuracy(
        installation_yaw=yaw_sigma(covariance),
        soft_iron=tuple(float(v) for v in np.sqrt(np.diag(iron @ covariance @ iron.T))),
        axial_hard_iron=math.sqrt(max(float(axial @ found.covariance @ axial), 0.0)),
        strength=math.sqrt(float(along @ earth @ along)) / MICROTESLA,
        inclination=math.sqrt(float(across @ earth @ across)),
        level=level,
        tilted=tilted,
        absolute_level=absolute_level,
        absolute_tilted=absolute_tilted,
    )


def _inverse(information: FloatArray) -> FloatArray:
    known = np.flatnonzero(np.diag(information) > 0.0)
    size = 1.0 / np.sqrt(np.diag(information)[known])
    scaled = information[np.ix_(known, known)] * np.outer(size, size)
    out = np.zeros_like(information)
    out[np.ix_(known, known)] = np.linalg.inv(scaled) * np.outer(size, size)
    return out


def advise(information: FloatArray, fit: Fit, mounting: FloatArray) -> tuple[TurnAdvice, ...]:
    """Return further turns, in order of the expected absolute heading error.

    Each repeats the turn of `fit` about another axis; its expected information is added to
    `information` (SHARED, SHARED), which includes the priors.
    """
    # The direction that all attitudes share is the turn's axis, in the body and in the world.
    inside, _, outside = np.linalg.svd(fit.state.attitude.mean(axis=0))
    axis, up = (math.copysign(1.0, outside[0, 2]) * each for each in (inside[:, 0], outside[0]))

    def after(body: FloatArray, world: FloatArray) -> TurnAccuracy:
        turned = minimal_rotation(axis, body), minimal_rotation(world, up)
        return accuracy_by(information + imagined_information(fit, *turned), fit, mounting)

    imagined = [TurnAdvice("on level ground once more", after(Z, Z))]
    for slope, leaning, (roll, pitch) in SIDES:
        axis_there = rotation_from_rpy(roll, pitch).T @ Z
        imagined += [
            TurnAdvice(f"on a slope of 10° that rises to the {slope}", after(Z, axis_there)),
            TurnAdvice(f"about the vertical with {leaning}", after(axis_there, Z)),
        ]
    return tuple(sorted(imagined, key=lambda advice: advice.after.absolute_tilted))


def join(
    windows: Sequence[Window], names: Sequence[str], knowledge: Knowledge
) -> tuple[list[Turn], Estimate | None, MultiTurnReport | None]:
    """Fit the turns, and leave out one after another until the rest agrees on one calibration.

    Of two turns that disagree, the later one is left out. Returns all turns, the joint estimate in
    level axes (None for less than two turns), and the report; None if no turn joined.
    """
    turns, joint_fit = fit_turns(windows, names, knowledge), None
    knowledge = in_axes(knowledge, level_rotation(knowledge.upward))
    sigma, misfit = knowledge.mounting.yaw_sigma, 0.0
    while members := [turn for turn in turns if not turn.refusal_words]:
        alone = [turn.fit for turn in members]
        try:
            joint_fit = fit_jointly(alone, sigma)
            both = zip(alone, joint_fit.fits, strict=True)
            misfit, gains = max(_misfit(*each) for each in both), dict[int, float]()
            if misfit >= COMPARED_ABOVE and len(alone) > 1:
                asked = range(len(alone)) if len(alone) > 2 else [1]
                gains = {k: _gain(alone, k, joint_fit, sigma) for k in asked}
        except np.linalg.LinAlgError:
            left_out, words = members[-1], "it has no solution together with the others"
        else:
            odd = max(gains, key=gains.__getitem__, default=0)
            if gains.get(odd, 0.0) <= 0.0:
                break
            others = "the other turns" if len(members) > 2 else "the turn before"
            left_out, words = members[odd], CONTRADICTS.format(others, misfit)
        turns[turns.index(left_out)] = replace(left_out, refusal_words=words)
    if joint_fit is None or not members:
        return turns, None, None
    mounting, count = knowledge.mounting.matrix, len(members)
    known = [_known(joint_fit, first) for first in range(1, count + 1)]
    shown = [accuracy_by(each, joint_fit.fits[0], mounting) for each in known]
    # The advice repeats the turn with the longest arc at other tilts.
    whole = int(np.argmax([turn.found[0].arc for turn in members]))
    advice = advise(known[-1], joint_fit.fits[whole], mounting)
    multi_turn = MultiTurnReport(_turn_results(turns, shown), advice)
    joint = joint_estimate(joint_fit, misfit, members, knowledge) if count > 1 else None
    return turns, joint, multi_turn


def _known(joint_fit: JointFit, count: int) -> FloatArray:
    """Return the information on the common unknowns, by the priors and the first turns.

    After one turn, the yaw of the installation is zero by convention, whatever sway shows of it.
    """
    known = np.asarray(joint_fit.prior + np.sum(joint_fit.informations[:count], axis=0))
    if count == 1:
        known[TURNED] = known[:, TURNED] = 0.0
        known[TURNED, TURNED] = joint_fit.prior[TURNED, TURNED]
    return known


def _turn_results(turns: list[Turn], shown: Sequence[TurnAccuracy]) -> tuple[TurnResult, ...]:
    results: list[TurnResult] = []
    coming, before = iter(shown), None
    for turn in turns:
        now = None if turn.refusal_words else next(coming)
        words = turn.refusal_words
        if now is not None:
            words, before = now.in_words if before is None else now.improvement(before), now
        results.append(TurnResult(turn.name, words, now))
    return tuple(results)
