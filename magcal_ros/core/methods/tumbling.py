"""Common part of the methods for tumbled sensors: from a fitted shape to an estimate.

They use the field alone. The symmetric matrix from an ellipsoid to a sphere leaves a rotation
undetermined: these methods assume that the magnetometer's axes (after the nominal mounting) are the
IMU's. The rotation by gravity is not corrected, but included in the covariance.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.calibration.correction import PARAMETERS, Correction
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray
from magcal_ros.core.geometry.attitude import unit, usual_size
from magcal_ros.core.geometry.rotations import skew
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.checks import SCREENING, refuse_empty
from magcal_ros.core.methods.methods_tuning import CLOUD
from magcal_ros.core.methods.resampling import jackknife_covariance
from magcal_ros.core.samples.window import Window

PROBES: FloatArray = unit(
    np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if d > (0.0, 0.0, 0.0)])
)
"""Thirteen directions (axes, edges and corners of a cube) in which the extent of the samples is
measured."""


@dataclass(frozen=True, eq=False)
class Shape:
    """Centre of the samples, and the matrix to a unit sphere."""

    centre: FloatArray  # tesla, in nominal body axes. Shape (3,).
    to_unit: FloatArray
    """Takes fields from the centre onto the unit sphere, per tesla. Shape (3, 3)."""
    radius: float  # tesla, the mean radius as the sensor reads it
    figures: Mapping[Figure, float]  # other figures of the method

    def on_sphere(self, nominal: FloatArray) -> FloatArray:
        """Return fields (n, 3) in nominal axes as points that should lie on the unit sphere."""
        return np.asarray((nominal - self.centre) @ self.to_unit.T)

    def correction(self, knowledge: Knowledge) -> Correction:
        """Return the correction, scaled to the reference's strength if that is known."""
        mounting = knowledge.mounting.matrix
        size = strength_of(self, knowledge)
        return Correction(size * self.to_unit @ np.linalg.inv(mounting), mounting @ self.centre)


Solve = Callable[[FloatArray], Shape]
"""Fits a shape to the field in nominal body axes without known gains (n, 3), tesla."""


@dataclass(frozen=True, eq=False)
class MountingRotation:
    """A rotation of the corrected field against the IMU, as far as gravity shows it."""

    cosine: float  # of the angle between the field and up
    rotation: FloatArray
    """Posterior mean of the rotation vector from the corrected field to the true one, radians.
    Shape (3,)."""
    covariance: FloatArray  # of `rotation`, rad². Shape (3, 3).
    scatter: float  # residual standard deviation of the cosine

    def covariance_of(self, matrix: FloatArray) -> FloatArray:
        """Return the covariance (12, 12) that the ignored rotation adds to that of A (3, 3)."""
        moment = np.outer(self.rotation, self.rotation) + self.covariance
        turned = np.array([(skew(axis) @ matrix).ravel() for axis in np.eye(3)])
        covariance = np.zeros((PARAMETERS, PARAMETERS))
        covariance[:9, :9] = turned.T @ moment @ turned
        return covariance


def estimate_mounting(direction: FloatArray, up: FloatArray) -> MountingRotation:
    """Estimate the rotation of the magnetometer against the IMU from the angle between two vectors.

    The angle between field and gravity is constant. A small rotation d of the correction changes
    it: u·m = c - d·(m x u), for unit vectors u up and m of the corrected field, both (n, 3) in the
    order of time. Tumbling determines all three components of d, which have a prior.
    """
    cosines = np.sum(direction * up, axis=1)
    design = np.column_stack([np.ones(len(up)), -np.cross(direction, up)])
    prior = np.diag([0.0, *np.full(3, CLOUD.installation_sigma**-2)])
    answer = np.linalg.lstsq(design, cosines, rcond=None)[0]
    residual = cosines - design @ answer
    # Noise-free samples need a floor.
    variance = max(float(np.mean(residual**2)), 1e-10)
    weight = 1.0 / (variance * _inefficiency(design, residual))
    inverse = np.linalg.inv(weight * design.T @ design + prior)
    covariance = np.asarray(inverse, dtype=np.float64)
    answer = weight * covariance @ design.T @ cosines
    return MountingRotation(float(answer[0]), answer[1:], covariance[1:, 1:], variance**0.5)


def _inefficiency(design: FloatArray, residual: FloatArray) -> float:
    """Return the inefficiency factor, from the scores of sixteen pieces of time; one or more."""
    scores = design * residual[:, None]
    pieces = np.array([piece.sum(axis=0) for piece in np.array_split(scores, 16)])
    single = np.maximum((scores**2).sum(axis=0), 1e-300)
    return max(1.0, float(np.mean((pieces**2).sum(axis=0) / single)))


def _refuse_flat(nominal: FloatArray) -> None:
    """Refuse samples that are constant or on a plane."""
    spread = np.linalg.svd(nominal - nominal.mean(axis=0), compute_uv=False)
    spread = spread / math.sqrt(len(nominal))
    if spread[0] < SCREENING.smallest_motion * usual_size(nominal):
        raise Refusal(
            Reason.NO_MOTION,
            "The field hardly changed. Tumble the sensor through all orientations.",
        )
    if spread[2] < CLOUD.thinnest_cloud * spread[0]:
        raise Refusal(
            Reason.PLANAR,
            "The field stayed near a plane, as in a turn about one axis: offset and scale across "
            "it cannot be seen. Tumble the sensor through all orientations, or use a method for "
            "turns about one axis.",
        )


def strength_of(shape: Shape, knowledge: Knowledge) -> float:
    """Return the reference's strength where known, else the shape's own radius, tesla."""
    reference = knowledge.reference.strength
    return shape.radius if reference.is_unknown else reference.value


def on_unit_sphere(distance: FloatArray, among: FloatArray | None = None) -> BoolArray:
    """Return which samples (n,) are on the sphere, by their distance (n,) from its centre.

    The usual distance and its spread are those of `among` (k,), by default of all samples.
    """
    others = distance if among is None else among
    usual = float(np.median(others))
    gate = CLOUD.outlier_deviations * 1.4826 * float(np.median(np.abs(others - usual)))
    # Samples without noise differ by rounding.
    return np.asarray(np.abs(distance - usual) <= gate + 1e-9)


def finish(
    solve: Solve,
    window: Window,
    knowledge: Knowledge,
    *,
    method: str,
    least_extent: float,
    remedy: str,
) -> Estimate:
    """Fit a shape, check it, and return the estimate.

    The estimate of `method` has no installation. The unit sphere, of extent 2, must be seen to
    `least_extent` in every direction; `remedy` is what to do if the samples are not on a sphere.
    Raises `Refusal` if the samples do not determine one.
    """
    nominal = window.field @ knowledge.mounting.to_body.T
    refuse_empty(window, CLOUD.fewest_samples)
    _refuse_flat(nominal)
    shape = solve(nominal)
    points = shape.on_sphere(nominal)
    inliers = on_unit_sphere(np.linalg.norm(points, axis=1))
    extent = _refuse_no_sphere(points[inliers], least_extent, remedy)
    correction = shape.correction(knowledge)
    covariance = jackknife_covariance(
        lambda part, known: solve(part.field @ known.mounting.to_body.T).correction(known),
        window,
        knowledge,
    )
    up = unit(window.specific_force[inliers])
    mounting = estimate_mounting(unit(points[inliers]), up)
    strength = strength_of(shape, knowledge)
    inclination = -math.asin(max(-1.0, min(1.0, mounting.cosine)))
    residual = window.field - correction.undo(strength * unit(points))
    figures = {**shape.figures, Figure.SPHERE_EXTENT: 0.5 * extent}
    figures[Figure.MISALIGNMENT] = float(np.linalg.norm(mounting.rotation))
    if not knowledge.reference.strength.is_unknown:
        figures[Figure.RADIUS_RATIO] = shape.radius / strength
    noise = math.sqrt(float((residual[inliers] ** 2).sum()) / max(int(inliers.sum()) - 9, 1))
    return Estimate(
        method=method,
        correction=correction,
        covariance=covariance + mounting.covariance_of(correction.matrix),
        installation=None,
        axis=np.array([0.0, 0.0, 1.0]),
        arc=2.0 * math.acos(max(-1.0, 1.0 - extent)),
        strength=strength,
        inclination=inclination,
        noise_field=noise,
        # An upper bound: the scatter contains the field's noise, too.
        noise_up=mounting.scatter / math.cos(min(abs(inclination), SCREENING.steepest)),
        inliers=inliers,
        residual=residual,
        figures=figures,
        message="closed form; the magnetometer's axes were assumed to be the IMU's",
    )


def _refuse_no_sphere(points: FloatArray, least: float, remedy: str) -> float:
    """Refuse points that are not on a sphere; returns their least extent in any direction."""
    extent = float(np.ptp(unit(points) @ PROBES.T, axis=0).min())
    if extent < least:
        raise Refusal(
            Reason.ARC_TOO_SHORT,
            f"In one direction only {50.0 * extent:.0f}% of the sphere of orientations was seen; "
            f"at least {50.0 * least:.0f}% are needed. Tumble the sensor through "
            "all orientations, upside down included.",
        )
    rms = float(np.sqrt(np.mean((np.linalg.norm(points, axis=1) - 1.0) ** 2)))
    if rms > SCREENING.worst_field_noise:
        raise Refusal(
            Reason.NO_SOLUTION,
            f"The corrected samples miss the sphere by {100.0 * rms:.0f}% of its radius. " + remedy,
        )
    return extent
