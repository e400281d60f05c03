"""The design tip from end to end."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.calibration import Estimate, Installation
from magcal_ros.core.calibration.correction import PARAMETERS, Correction
from magcal_ros.core.calibration.figure import Figure, along
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import FRD_FROM_FLU
from magcal_ros.core.geometry.conics import ConicFit
from magcal_ros.core.geometry.rotations import rotation_angle, rotation_from_rpy
from magcal_ros.core.knowledge import Knowledge, ReferenceField
from magcal_ros.core.methods.checks import refuse_empty
from magcal_ros.core.methods.design_tip.axial_field import BelievedField, believe
from magcal_ros.core.methods.design_tip.axis import TurnAxis, find_axis
from magcal_ros.core.methods.design_tip.circle import FieldCircle, derotation, fit_field_circle
from magcal_ros.core.methods.design_tip.installation import Candidate, find_candidates
from magcal_ros.core.methods.design_tip.options import Options
from magcal_ros.core.methods.design_tip.tip_frame import ROUNDING, TipSamples, enter, leave
from magcal_ros.core.methods.resampling import jackknife_covariance
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class TipTuning:
    """Which turns can be answered, and when two answers are told apart."""

    shortest_arc: float = math.radians(45.0)
    """Radians of turn."""
    steepest_inclination: float = math.radians(80.0)
    """Radians."""
    smallest_radius: float = 0.15
    """Share of the field's strength below which the circle shows no direction."""
    tilted_axis: float = math.radians(20.0)
    """Radians of tilt from which a small circle is blamed on an axis along the field."""
    strength_margin: float = 0.1
    """Share of the strength by which an installation may fit the reference worse than the best."""
    rival_margin: float = math.radians(2.0)
    """Radians by which a rival's installation may be larger than the chosen one's and as likely."""
    rival_distance: float = math.radians(5.0)
    """Rivals nearer than this are one answer."""


TUNING = TipTuning()


def fit(
    window: Window, knowledge: Knowledge = Knowledge(), *, options: Options = Options()
) -> Estimate:
    """Calibrate by the ST design tip DT0103, its traps left out.

    Parameters
    ----------
    window : Window
        One turn about one axis within 75° of the vertical, at least 45° of it.
    knowledge : Knowledge
        Reference field and mounting. Residual soft iron is not modelled.
    options : Options
        Choice of the fits.

    Returns
    -------
    Estimate
        With `figures` as `measure_figures` names them. Its covariance comes from leaving out
        pieces of the turn and from the reference's uncertainty.

    Raises
    ------
    Refusal
        If the samples cannot carry an answer; its text says why and what to do.
    """
    refuse_empty(window, options.min_samples)
    solution = solve(window, knowledge, options)
    _refuse_unusable(solution, knowledge.reference)
    covariance = jackknife_covariance(
        lambda part, known: solve(part, known, options).correction,
        window,
        knowledge,
        blocks=options.jackknife_blocks,
        unknown=_axial_unknown(solution, options),
    )
    residual = solution.chosen.circle.model_error @ solution.samples.mounting.T
    noise_field = math.sqrt(float((residual**2).sum()) / max(2 * len(window) - 6, 1))
    return Estimate(
        method="design_tip",
        correction=solution.correction,
        covariance=covariance,
        installation=solution.installation,
        axis=-FRD_FROM_FLU @ solution.axis.direction,
        arc=solution.circle.arc,
        strength=solution.believed.strength,
        inclination=solution.believed.inclination,
        noise_field=noise_field,
        noise_up=solution.axis.noise,
        inliers=np.ones(len(window), dtype=np.bool_),
        residual=residual,
        figures=measure_figures(solution, noise_field),
        message=f"closed form; {solution.believed.basis}",
    )


def solve(window: Window, knowledge: Knowledge, options: Options) -> TipSolution:
    """Take the tip's steps on whatever samples there are.

    Raises
    ------
    Refusal
        If a step has no answer.
    """
    samples = enter(window, knowledge.mounting)
    circle = _circle_or_reason(samples, options)
    axis = find_axis(samples, circle, options)
    chosen, rival, believed = _choose(samples, axis, circle, knowledge.reference)
    iron = chosen.circle.centre - believed.axial * chosen.circle.normal
    correction, installation = leave(chosen.roll, chosen.pitch, iron, knowledge.mounting)
    return TipSolution(samples, circle, axis, chosen, rival, believed, correction, installation)


def _circle_or_reason(samples: TipSamples, options: Options) -> FieldCircle:
    try:
        return fit_field_circle(samples, options)
    except Refusal as refusal:
        spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(samples.down.T)), 0.0))
        gravity_turned = spread[2] > 1e-3 and spread[2] > 5.0 * spread[0]
        if refusal.reason is Reason.NO_MOTION and gravity_turned:
            raise _axis_along_field() from refusal
        raise


def _choose(
    samples: TipSamples, axis: TurnAxis, circle: FieldCircle, reference: ReferenceField
) -> tuple[Candidate, Candidate | None, BelievedField]:
    """Choose the smallest installation among those that fit the reference field."""
    candidates = find_candidates(samples, axis, circle)
    believed = [believe(reference, candidate, axis) for candidate in candidates]
    misfit = np.array(
        [
            abs(math.hypot(candidate.circle.radius, field.axial) / field.strength - 1.0)
            for candidate, field in zip(candidates, believed, strict=True)
        ]
    )
    fitting = np.flatnonzero(misfit <= misfit.min() + TUNING.strength_margin)
    first = int(fitting[0])
    chosen = candidates[first]
    others = [candidate for index, candidate in enumerate(candidates) if index != first]
    for index in fitting[1:]:
        _refuse_rival(chosen, candidates[int(index)])
    return chosen, (others[0] if others else None), believed[first]


def _refuse_rival(chosen: Candidate, rival: Candidate) -> None:
    own, other = (rotation_from_rpy(each.roll, each.pitch) for each in (chosen, rival))
    is_same_size = rival.angle - chosen.angle < TUNING.rival_margin
    if is_same_size and rotation_angle(own @ other.T) > TUNING.rival_distance:
        raise Refusal(
            Reason.AMBIGUOUS,
            "Two installations of the magnetometer of the same size explain this turn. Turn about "
            "an axis nearer to the vertical, or give the nominal mounting.",
        )


def _axial_unknown(solution: TipSolution, options: Options) -> FloatArray:
    unknown = np.zeros(PARAMETERS)
    if solution.believed.axial_unknown:
        along = solution.samples.mounting @ solution.chosen.circle.normal
        unknown[9:] = options.axial_sigma * along
    return unknown


def _refuse_unusable(solution: TipSolution, reference: ReferenceField) -> None:
    circle, believed = solution.circle, solution.believed
    if circle.arc < TUNING.shortest_arc:
        raise Refusal(
            Reason.ARC_TOO_SHORT,
            f"Only {math.degrees(circle.arc):.0f}° of the turn were seen; at least "
            f"{math.degrees(TUNING.shortest_arc):.0f}° are needed. Turn further round, best a "
            "full turn.",
        )
    if (
        not reference.strength.is_unknown
        and circle.radius < TUNING.smallest_radius * believed.strength
    ):
        if solution.axis.tilt > TUNING.tilted_axis:
            raise _axis_along_field()
        raise Refusal(
            Reason.CIRCLE_TOO_SMALL,
            f"The field's circle has a radius of {circle.radius * 1e6:.1f} µT only. Check the "
            "field's unit (tesla) and the reference; shielded rooms and poles show no heading.",
        )
    if abs(believed.inclination) > TUNING.steepest_inclination:
        raise Refusal(
            Reason.FIELD_TOO_STEEP,
            f"The field is inclined by {math.degrees(believed.inclination):.0f}°: too steep for "
            "a compass. Check the reference field, or calibrate elsewhere.",
        )


def _axis_along_field() -> Refusal:
    return Refusal(
        Reason.AXIS_ALONG_FIELD,
        "The robot turned about the field's own direction, so the field hardly changed. Turn "
        "about an axis nearer to the vertical.",
    )


TIP_NOISE_MULTIPLE = 6.0
"""The tip calls a cloud a cluster when its mean distance is below this many times the noise."""


@dataclass(frozen=True, eq=False)
class TipSolution:
    """The steps' results before their uncertainty is known."""

    samples: TipSamples
    circle: FieldCircle
    axis: TurnAxis
    chosen: Candidate
    rival: Candidate | None
    believed: BelievedField
    correction: Correction
    installation: Installation


def measure_figures(solution: TipSolution, noise_field: float) -> dict[Figure, float]:
    """Collect the figures by name.

    Parameters
    ----------
    solution : TipSolution
        What the steps found.
    noise_field : float
        Tesla per axis.

    Returns
    -------
    dict of Figure to float
        `accelerometer_spread_over_noise`, `field_spread_over_noise`: mean distance from the
        cloud's centre over six times the noise, the tip's measure of a plane's reliability.
        `accelerometer_range_x`, `_y`, `_z` (m/s² over gravity) and `field_range_x`, `_y`, `_z`
        (tesla): ranges after de-rotation; z should be the smallest by far.
        `circle_radius` (tesla); `radius_ratio`: over the radius that strength and axis demand;
        `ellipse_ratio`: of a free ellipse, where there is one.
        `axis_tilt` (rad); `axial_field`, `axial_hard_iron` (tesla).
        `installation_angle` and, where the turn has a second solution, `rival_roll`,
        `rival_pitch`, `rival_angle` (rad, URDF sense).
    """
    samples, axis, chosen = solution.samples, solution.axis, solution.chosen
    rival, believed, circle = solution.rival, solution.believed, chosen.circle
    figures = {
        Figure.ACCELEROMETER_SPREAD: _spread(samples.down, axis.noise, ROUNDING),
        Figure.FIELD_SPREAD: _spread(samples.field, noise_field, ROUNDING * believed.strength),
        Figure.CIRCLE_RADIUS: circle.radius,
        Figure.AXIS_TILT: axis.tilt,
        Figure.AXIAL_FIELD: believed.axial,
        Figure.AXIAL_HARD_IRON: circle.height - believed.axial,
        Figure.INSTALLATION_ANGLE: chosen.angle,
    }
    down = samples.down @ derotation(axis.direction)
    figures |= along("accelerometer_range", np.ptp(down, axis=0))
    figures |= along("field_range", np.ptp(samples.field @ circle.basis, axis=0))
    expected = believed.strength**2 - believed.axial**2
    if expected > 0.0:
        figures[Figure.RADIUS_RATIO] = circle.radius / math.sqrt(expected)
    try:
        flat = np.column_stack([circle.phasor.real, circle.phasor.imag])
        figures[Figure.ELLIPSE_RATIO] = ConicFit.HALIR_FLUSSER(flat).ratio
    except Refusal:
        pass
    if rival is not None:
        figures |= {
            Figure.RIVAL_ROLL: rival.roll,
            Figure.RIVAL_PITCH: -rival.pitch,
            Figure.RIVAL_ANGLE: rival.angle,
        }
    return figures


def _spread(cloud: FloatArray, noise: float, least_noise: float) -> float:
    distance = np.linalg.norm(cloud - cloud.mean(axis=0), axis=1).mean()
    return float(distance / (TIP_NOISE_MULTIPLE * max(noise, least_noise)))
