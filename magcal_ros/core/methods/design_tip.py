"""The ST design tip DT0103 (A. Vitali, 2018): accelerometer-assisted calibration in a plane.

Installation error and hard iron from one turn, in closed form. The steps are the turn's axis from
the accelerometer, the normal of the field's plane, the centre of the field's circle, and the
installation that rotates one normal to the other. Known errors of the tip are corrected: normals
that are forced upwards separately, the Newton search, the switch between level and tilted axes, and
answers to samples that do not determine a solution.
"""

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
from magcal_ros.core.geometry.rotations import rotation_angle, rotation_from_rpy
from magcal_ros.core.geometry.shapes import SMALLEST, ellipse_ratio
from magcal_ros.core.knowledge import Knowledge, ReferenceField
from magcal_ros.core.methods.checks import SCREENING, check_arc, check_radius, check_window
from magcal_ros.core.methods.methods_tuning import TIP
from magcal_ros.core.methods.resampling import jackknife_covariance
from magcal_ros.core.methods.tip_steps import (
    Candidate,
    FieldCircle,
    TipSamples,
    TurnAxis,
    derotation,
    find_axis,
    find_candidates,
    fit_field_circle,
    prepare_samples,
)
from magcal_ros.core.samples.coverage import Coverage
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class AssumedField:
    """The reference field that the solution uses: as given, or with numbers from the turn."""

    strength: float  # tesla
    inclination: float  # radians
    axial: float  # component along the axis, downwards, tesla
    basis: str  # what it is derived from, in words
    axial_unknown: bool = False  # whether the hard iron along the axis is an assumption


@dataclass(frozen=True, eq=False)
class TipSolution:
    """The results of the steps, without covariance."""

    samples: TipSamples
    circle: FieldCircle
    axis: TurnAxis
    chosen: Candidate
    rival: Candidate | None
    assumed: AssumedField
    correction: Correction
    installation: Installation


def fit(window: Window, knowledge: Knowledge = Knowledge()) -> Estimate:
    """Calibrate by the ST design tip DT0103, with its known errors corrected.

    The turn is at least 45° about one axis within 75° of the vertical. Reference field and mounting
    are used; residual soft iron is not modelled. The covariance comes from a jackknife over pieces
    of the turn and from the reference's uncertainty. Raises `Refusal` if the samples do not
    determine a solution.
    """
    check_window(window, knowledge)
    solution = solve(window, knowledge)
    circle, assumed = solution.circle, solution.assumed
    arc = Coverage.of(np.angle(circle.phasor)).arc
    check_arc(arc, solved_by_knowledge=True)
    check_radius(circle.radius / assumed.strength, assumed.inclination, solution.axis.tilt)
    covariance = jackknife_covariance(
        lambda part, known: solve(part, known).correction,
        window,
        knowledge,
        unknown=_axial_unknown(solution),
    )
    residual = solution.chosen.circle.model_error @ solution.samples.mounting.T
    noise_field = math.sqrt(float((residual**2).sum()) / max(2 * len(window) - 6, 1))
    return Estimate(
        method="design_tip",
        correction=solution.correction,
        covariance=covariance,
        installation=solution.installation,
        axis=-FRD_FROM_FLU @ solution.axis.direction,
        arc=arc,
        strength=assumed.strength,
        inclination=assumed.inclination,
        noise_field=noise_field,
        noise_up=solution.axis.noise,
        inliers=np.ones(len(window), dtype=np.bool_),
        residual=residual,
        figures=measure_figures(solution, noise_field),
        message=f"closed form; {assumed.basis}",
    )


def solve(window: Window, knowledge: Knowledge) -> TipSolution:
    """Return the results of the tip's steps. Raises `Refusal` if a step has no solution."""
    samples = prepare_samples(window, knowledge.mounting)
    circle = fit_field_circle(samples)
    axis = find_axis(samples, circle)
    chosen, rival, assumed = _choose(samples, axis, circle, knowledge.reference)
    iron = chosen.circle.centre - assumed.axial * chosen.circle.normal
    # The tip's rotation is passive in forward-right-down axes: its pitch has the other sign.
    installation = Installation(chosen.roll, -chosen.pitch)
    matrix = installation.pose @ knowledge.mounting.to_body
    correction = Correction(matrix, samples.mounting @ iron)
    return TipSolution(samples, circle, axis, chosen, rival, assumed, correction, installation)


def _choose(
    samples: TipSamples, axis: TurnAxis, circle: FieldCircle, reference: ReferenceField
) -> tuple[Candidate, Candidate | None, AssumedField]:
    """Choose the smallest installation among those that fit the reference field."""
    candidates = find_candidates(samples, axis, circle)
    assumed = [assumed_field(reference, candidate, axis) for candidate in candidates]
    misfit = np.array(
        [
            abs(math.hypot(candidate.circle.radius, field.axial) / field.strength - 1.0)
            for candidate, field in zip(candidates, assumed, strict=True)
        ]
    )
    fitting = np.flatnonzero(misfit <= misfit.min() + TIP.strength_margin)
    first = int(fitting[0])
    chosen = candidates[first]
    others = candidates[:first] + candidates[first + 1 :]
    own = rotation_from_rpy(chosen.roll, chosen.pitch)
    for rival in (candidates[int(index)] for index in fitting[1:]):
        apart = rotation_angle(own @ rotation_from_rpy(rival.roll, rival.pitch).T)
        is_same_size = rival.angle - chosen.angle < TIP.rival_margin
        if is_same_size and apart > SCREENING.widest_rival:
            raise Refusal(
                Reason.AMBIGUOUS,
                "Two equally large rotations of the magnetometer explain this turn. Turn about "
                "an axis nearer to the vertical, or give the nominal mounting.",
            )
    return chosen, (others[0] if others else None), assumed[first]


def _axial_unknown(solution: TipSolution) -> FloatArray:
    unknown = np.zeros(PARAMETERS)
    if solution.assumed.axial_unknown:
        along = solution.samples.mounting @ solution.chosen.circle.normal
        unknown[9:] = TIP.axial_sigma * along
    return unknown


def measure_figures(solution: TipSolution, noise_field: float) -> dict[Figure, float]:
    """Return the figures of a solution; `noise_field` is in tesla per axis."""
    samples, axis, chosen = solution.samples, solution.axis, solution.chosen
    rival, assumed, circle = solution.rival, solution.assumed, chosen.circle
    figures = {
        Figure.ACCELEROMETER_SPREAD: _spread(samples.down, axis.noise, SMALLEST),
        Figure.FIELD_SPREAD: _spread(samples.field, noise_field, SMALLEST * assumed.strength),
        Figure.CIRCLE_RADIUS: circle.radius,
        Figure.AXIS_TILT: axis.tilt,
        Figure.AXIAL_FIELD: assumed.axial,
        Figure.AXIAL_HARD_IRON: circle.height - assumed.axial,
        Figure.INSTALLATION_ANGLE: chosen.angle,
    }
    down = samples.down @ derotation(axis.direction)
    figures |= along("accelerometer_range", np.ptp(down, axis=0))
    figures |= along("field_range", np.ptp(samples.field @ circle.basis, axis=0))
    expected = assumed.strength**2 - assumed.axial**2
    if expected > 0.0:
        figures[Figure.RADIUS_RATIO] = circle.radius / math.sqrt(expected)
    ratio = ellipse_ratio(np.column_stack([circle.phasor.real, circle.phasor.imag]))
    if ratio is not None:
        figures[Figure.ELLIPSE_RATIO] = ratio
    if rival is not None:
        figures |= {
            Figure.RIVAL_ROLL: rival.roll,
            Figure.RIVAL_PITCH: -rival.pitch,
            Figure.RIVAL_ANGLE: rival.angle,
        }
    return figures


def _spread(cloud: FloatArray, noise: float, least_noise: float) -> float:
    distance = np.linalg.norm(cloud - cloud.mean(axis=0), axis=1).mean()
    return float(distance / (6.0 * max(noise, least_noise)))


def assumed_field(reference: ReferenceField, candidate: Candidate, axis: TurnAxis) -> AssumedField:
    """Return the reference field with its axial component, from the known numbers.

    The product of gravity and field is the strength times the sine of the inclination, in the world
    as in the body: c k + d = B sin(i). Here c is the cosine between axis and vertical, k the field
    along the axis and d the product across the axis. Also, k² + radius² = B². The turn need not
    start facing north on level ground. Raises `Refusal` if the circle contradicts the reference.
    """
    strength, inclination = reference.strength, reference.inclination
    radius, height = candidate.circle.radius, candidate.circle.height
    across, cosine = candidate.gravity_dot_field, axis.axial_gravity
    if not inclination.is_unknown:
        sine, sizes = math.sin(inclination.value), [strength.value]
        basis = "strength and inclination as given"
        if strength.is_unknown:
            sizes = _strengths(sine, cosine, across, radius)
            basis = "inclination as given, strength from the circle's radius"
        fields = [(size, (size * sine - across) / cosine) for size in sizes]
        size, axial = min(fields, key=lambda field: abs(height - field[1]))
        return AssumedField(size, inclination.value, axial, basis)
    axial = height
    basis = "neither strength nor inclination is known: no hard iron along the axis is assumed"
    if not strength.is_unknown:
        if radius > (1.0 + TIP.strength_margin) * strength.value:
            raise _contradiction("strength")
        axial = math.copysign(math.sqrt(max(strength.value**2 - radius**2, 0.0)), height)
        basis = "strength as given, inclination from the circle's radius and the smaller hard iron"
    size = math.hypot(radius, axial)
    vertical = max(-1.0, min(1.0, (cosine * axial + across) / size))
    return AssumedField(size, math.asin(vertical), axial, basis, strength.is_unknown)


def _strengths(sine: float, cosine: float, across: float, radius: float) -> list[float]:
    """Return the solutions B of (B sin(i) - d)² + c² radius² = c² B², one or two."""
    root = across**2 + radius**2 * (cosine**2 - sine**2)
    signs = (1.0, -1.0) if root >= 0.0 else ()
    denominators = [sine * across + sign * cosine * math.sqrt(root) for sign in signs]
    # The product of the roots is constant/(s² - c²): this form stays finite where s = c.
    constant = across**2 + cosine**2 * radius**2
    found = [constant / value for value in denominators if value > 0.0]
    if not found:
        raise _contradiction("inclination")
    return found


def _contradiction(known: str) -> Refusal:
    return Refusal(
        Reason.NO_SOLUTION,
        f"The circle's radius contradicts the {known} of the reference field. Check the "
        "reference, the field's unit (tesla) and the soft-iron gains.",
    )
