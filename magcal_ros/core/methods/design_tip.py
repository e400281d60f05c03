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
from magcal_ros.core.geometry.rotations import (
    roll_pitch_between,
    rotation_angle,
    rotation_from_rpy,
)
from magcal_ros.core.geometry.shapes import SMALLEST, ellipse_ratio
from magcal_ros.core.knowledge import Knowledge, ReferenceField
from magcal_ros.core.methods.checks import SCREENING, check_arc, check_radius, check_window
from magcal_ros.core.methods.methods_tuning import TIP
from magcal_ros.core.methods.resampling import jackknife_covariance
from magcal_ros.core.methods.tip_steps import (
    FieldCircle,
    TipSamples,
    TurnAxis,
    derotation,
    find_axis,
    fit_field_circle,
    prepare_samples,
)
from magcal_ros.core.samples.coverage import Coverage
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True, eq=False)
class Candidate:
    """An installation that fits the two normals, with the field of the Earth that belongs to it."""

    installation: Installation
    circle: FieldCircle  # the field's circle with the normal that this installation needs
    strength: float  # tesla
    inclination: float  # radians
    axial: float  # component of the Earth's field along the axis, downwards, tesla
    basis: str  # what the Earth's field is derived from, in words


@dataclass(frozen=True, eq=False)
class TipSolution:
    """The results of the steps, without covariance."""

    samples: TipSamples
    axis: TurnAxis
    chosen: Candidate
    rival: Candidate | None
    correction: Correction


def fit(window: Window, knowledge: Knowledge = Knowledge()) -> Estimate:
    """Calibrate by the ST design tip DT0103, with its known errors corrected.

    The turn is at least 45° about one axis within 75° of the vertical. Reference field and mounting
    are used; residual soft iron is not modelled. The covariance comes from a jackknife over pieces
    of the turn and from the reference's uncertainty. Raises `Refusal` if the samples do not
    determine a solution.
    """
    check_window(window, knowledge)
    solution = solve(window, knowledge)
    chosen, axis, reference = solution.chosen, solution.axis, knowledge.reference
    circle, mounting = chosen.circle, solution.samples.mounting
    arc = Coverage.of(np.angle(circle.phasor)).arc
    check_arc(arc, solved_by_knowledge=True)
    check_radius(circle.radius / chosen.strength, chosen.inclination, axis.tilt)
    unknown = np.zeros(PARAMETERS)
    if reference.strength.is_unknown and reference.inclination.is_unknown:
        unknown[9:] = TIP.axial_sigma * mounting @ circle.basis[:, 2]
    covariance = jackknife_covariance(
        lambda part, known: solve(part, known).correction, window, knowledge, unknown
    )
    residual = circle.model_error @ mounting.T
    noise_field = math.sqrt(float((residual**2).sum()) / max(2 * len(window) - 6, 1))
    return Estimate(
        method="design_tip",
        correction=solution.correction,
        covariance=covariance,
        installation=chosen.installation,
        axis=-FRD_FROM_FLU @ axis.direction,
        arc=arc,
        strength=chosen.strength,
        inclination=chosen.inclination,
        noise_field=noise_field,
        noise_up=axis.noise,
        inliers=np.ones(len(window), dtype=np.bool_),
        residual=residual,
        figures=_figures(solution, noise_field),
        message=f"closed form; {chosen.basis}",
    )


def solve(window: Window, knowledge: Knowledge) -> TipSolution:
    """Return the results of the tip's steps. Raises `Refusal` if a step has no solution."""
    samples = prepare_samples(window, knowledge.mounting)
    circle = fit_field_circle(samples)
    axis = find_axis(samples, circle)
    chosen, rival = _choose(find_candidates(samples, axis, circle, knowledge.reference))
    iron = chosen.circle.basis @ (chosen.circle.middle - np.array([0.0, 0.0, chosen.axial]))
    matrix = chosen.installation.pose @ knowledge.mounting.to_body
    correction = Correction(matrix, samples.mounting @ iron)
    return TipSolution(samples, axis, chosen, rival, correction)


def _choose(candidates: list[Candidate]) -> tuple[Candidate, Candidate | None]:
    """Choose the smallest installation among those that fit the reference field, and a rival."""
    misfit = np.array(
        [abs(math.hypot(c.circle.radius, c.axial) / c.strength - 1.0) for c in candidates]
    )
    first, *fitting = np.flatnonzero(misfit <= misfit.min() + TIP.strength_margin)
    chosen, others = candidates[first], candidates[:first] + candidates[first + 1 :]
    for rival in (candidates[index] for index in fitting):
        apart = rotation_angle(chosen.installation.pose @ rival.installation.pose.T)
        is_same_size = rival.installation.angle - chosen.installation.angle < TIP.rival_margin
        if is_same_size and apart > SCREENING.widest_rival:
            raise Refusal(
                Reason.AMBIGUOUS,
                "Two equally large rotations of the magnetometer explain this turn. Turn about "
                "an axis nearer to the vertical, or give the nominal mounting.",
            )
    return chosen, others[0] if others else None


def _figures(solution: TipSolution, noise_field: float) -> dict[Figure, float]:
    """Return the figures of a solution; `noise_field` is in tesla per axis."""
    samples, axis, chosen = solution.samples, solution.axis, solution.chosen
    rival, circle = solution.rival, chosen.circle
    figures = {
        Figure.ACCELEROMETER_SPREAD: _spread(samples.down, axis.noise, SMALLEST),
        Figure.FIELD_SPREAD: _spread(samples.field, noise_field, SMALLEST * chosen.strength),
        Figure.CIRCLE_RADIUS: circle.radius,
        Figure.AXIS_TILT: axis.tilt,
        Figure.AXIAL_FIELD: chosen.axial,
        Figure.AXIAL_HARD_IRON: float(circle.middle[2]) - chosen.axial,
        Figure.INSTALLATION_ANGLE: chosen.installation.angle,
    }
    down = samples.down @ derotation(axis.direction)
    figures |= along("accelerometer_range", np.ptp(down, axis=0))
    figures |= along("field_range", np.ptp(samples.field @ circle.basis, axis=0))
    expected = chosen.strength**2 - chosen.axial**2
    if expected > 0.0:
        figures[Figure.RADIUS_RATIO] = circle.radius / math.sqrt(expected)
    ratio = ellipse_ratio(np.column_stack([circle.phasor.real, circle.phasor.imag]))
    if ratio is not None:
        figures[Figure.ELLIPSE_RATIO] = ratio
    if rival is not None:
        figures |= {
            Figure.RIVAL_ROLL: rival.installation.roll,
            Figure.RIVAL_PITCH: rival.installation.pitch,
            Figure.RIVAL_ANGLE: rival.installation.angle,
        }
    return figures


def _spread(cloud: FloatArray, noise: float, least_noise: float) -> float:
    distance = np.linalg.norm(cloud - cloud.mean(axis=0), axis=1).mean()
    return float(distance / (6.0 * max(noise, least_noise)))


def find_candidates(
    samples: TipSamples, axis: TurnAxis, circle: FieldCircle, reference: ReferenceField
) -> list[Candidate]:
    """Return every installation that fits, at least one, the smallest first.

    The field turns about its normal in the same sense as gravity about the axis. If neither gravity
    nor a gyro shows this sense, both normals are tried. Raises `Refusal` if none fits, if the pitch
    is not observable, or if gravity and gyro contradict each other.
    """
    if math.hypot(float(axis.direction[0]), float(axis.direction[2])) < TIP.smallest_lever:
        raise Refusal(
            Reason.AMBIGUOUS,
            "The robot turned about the IMU's y axis, which does not show the magnetometer's "
            "pitch. Give the mounting in the robot's frame, so that the turn is about its z axis.",
        )
    sense = _sense(samples, axis, circle)
    circles = [c for s, c in ((1, circle), (-1, circle.flipped())) if sense in (0, s)]
    both = [
        (c, r, p) for c in circles for r, p in roll_pitch_between(axis.direction, c.basis[:, 2])
    ]
    if not both:
        raise Refusal(
            Reason.NO_SOLUTION,
            "No roll and pitch of the magnetometer explain the turn. Check that the accelerometer "
            "and the magnetometer are on the same body and that their axes are right-handed.",
        )
    found = [_candidate(reference, axis, *each) for each in both]
    return sorted(found, key=lambda candidate: candidate.installation.angle)


def _candidate(
    reference: ReferenceField, axis: TurnAxis, circle: FieldCircle, roll: float, pitch: float
) -> Candidate:
    """Return an installation with the field of the Earth, from the known numbers.

    The product of gravity and field is the strength times the sine of the inclination, in the world
    as in the body: c k + d = B sin(i). Here c is the cosine between axis and vertical, k the field
    along the axis and d the product across the axis. Also, k² + radius² = B². The turn need not
    start facing north on level ground. Raises `Refusal` if the circle contradicts the reference.
    """
    strength, inclination = reference.strength, reference.inclination
    radius, height, cosine = circle.radius, float(circle.middle[2]), axis.axial_gravity
    # The tip's rotation is passive in forward-right-down axes: its pitch has the other sign.
    installation = Installation(roll, -pitch)
    product = axis.across * (circle.offsets @ rotation_from_rpy(roll, pitch).T)
    across = float(np.sum(product, axis=1).mean())
    if not inclination.is_unknown:
        sine, sizes = math.sin(inclination.value), [strength.value]
        basis = "strength and inclination as given"
        if strength.is_unknown:
            sizes = _strengths(sine, cosine, across, radius)
            basis = "inclination as given, strength from the circle's radius"
        fields = [(size, (size * sine - across) / cosine) for size in sizes]
        size, axial = min(fields, key=lambda field: abs(height - field[1]))
        return Candidate(installation, circle, size, inclination.value, axial, basis)
    axial = height
    basis = "neither strength nor inclination is known: no hard iron along the axis is assumed"
    if not strength.is_unknown:
        if radius > (1.0 + TIP.strength_margin) * strength.value:
            raise _contradiction("strength")
        axial = math.copysign(math.sqrt(max(strength.value**2 - radius**2, 0.0)), height)
        basis = "strength as given, inclination from the circle's radius and the smaller hard iron"
    size = math.hypot(radius, axial)
    vertical = max(-1.0, min(1.0, (cosine * axial + across) / size))
    return Candidate(installation, circle, size, math.asin(vertical), axial, basis)


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


def _sense(samples: TipSamples, axis: TurnAxis, circle: FieldCircle) -> int:
    by_gravity = _sense_by_gravity(axis, circle)
    by_gyro = _sense_by_gyro(samples, axis, circle)
    if by_gravity * by_gyro < 0:
        raise Refusal(
            Reason.AXES_DISAGREE,
            "Gyro and gravity turn in opposite senses. Check the axes and signs of the gyro.",
        )
    return by_gravity or by_gyro


def _sense_by_gravity(axis: TurnAxis, circle: FieldCircle) -> int:
    first, second = np.linalg.svd(axis.direction[None, :])[2][1:]
    second = second * float(np.cross(first, second) @ axis.direction)
    gravity = axis.across @ first + 1j * (axis.across @ second)
    field = circle.phasor / np.abs(circle.phasor).mean()
    same, opposite = abs((gravity * field.conj()).mean()), abs((gravity * field).mean())
    standard_error = max(axis.noise, SMALLEST) / math.sqrt(len(field))
    if abs(same - opposite) < TIP.clear_sense * standard_error:
        return 0
    return 1 if same > opposite else -1


def _sense_by_gyro(samples: TipSamples, axis: TurnAxis, circle: FieldCircle) -> int:
    if samples.turned is None:
        return 0
    # A field fixed in the world turns backwards in the body. Sines, because the field does not show
    # the sense of a step of half a turn during a gap.
    expected = np.sin(-(samples.turned @ axis.direction))
    seen = np.sin(np.angle(circle.phasor[1:] * circle.phasor[:-1].conj()))
    power = float(expected @ expected)
    slope = float(expected @ seen) / power if power > 0.0 else 0.0
    # One if both turn alike, zero if the gyro has nothing to do with the field.
    return round(max(-1.0, min(1.0, slope)))
