"""What the methods for tumbled sensors share: from a fitted shape to an estimate.

They look at the field alone. The symmetric matrix that takes an ellipsoid to a sphere leaves a
rotation open, so these methods take the magnetometer's axes for the IMU's (after the nominal
mounting); what gravity shows of the contrary enters the covariance.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.checks import refuse_empty
from magcal_ros.core.methods.mounting import SeenMounting, look_at_mounting
from magcal_ros.core.methods.resampling import jackknife_covariance
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class CloudTuning:
    """Which clouds of field samples a tumble can have left."""

    thinnest_cloud: float = 0.15
    """Smallest over largest standard deviation of a cloud; below it is a plane with noise."""
    least_motion: float = 0.02
    """Standard deviation of the field over its size; below it nothing moved."""
    largest_residual: float = 0.15
    """Root mean square of the distance from the sphere over its radius; beyond it is no sphere."""
    outlier_deviations: float = 5.0
    """Robust standard deviations from the usual distance beyond which a sample is an outlier."""
    least_gate: float = 0.02
    """Share of the radius within which a sample is always believed."""
    least_level_share: float = 0.1
    """Of the field that is taken to be level where it is steeper than a compass can bear."""


CLOUD = CloudTuning()


PROBES: FloatArray = unit(
    np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if d > (0.0, 0.0, 0.0)])
)
"""Thirteen directions, an axis, an edge or a corner of a cube each, in which to ask for samples."""


@dataclass(frozen=True, eq=False)
class Shape:
    """What a method found: where the cloud's centre is, and what makes it a sphere."""

    centre: FloatArray
    """Tesla, in nominal body axes. Shape (3,)."""
    to_unit: FloatArray
    """Takes fields from the centre onto the unit sphere, per tesla. Shape (3, 3)."""
    radius: float
    """Tesla, the mean radius as the sensor reads it."""
    figures: Mapping[Figure, float]
    """What the method measured besides."""

    def on_sphere(self, nominal: FloatArray) -> FloatArray:
        """Return fields (n, 3) in nominal axes as points that should lie on the unit sphere."""
        return np.asarray((nominal - self.centre) @ self.to_unit.T)

    def correction(self, knowledge: Knowledge) -> Correction:
        """Return the correction, scaled to the reference's strength where that is known."""
        mounting = knowledge.mounting.matrix
        size = believed_strength(self, knowledge)
        return Correction(size * self.to_unit @ np.linalg.inv(mounting), mounting @ self.centre)


Solve = Callable[[Window, Knowledge], Shape]


@dataclass(frozen=True, kw_only=True)
class TumblingOptions:
    """Choices that all methods for tumbled sensors have."""

    min_samples: int = 40
    """Fewer are refused."""
    jackknife_blocks: int = 16
    """Pieces of time that the covariance leaves out one by one."""
    installation_sigma: float = math.radians(3.0)
    """Radians per axis that the magnetometer may be turned against the IMU, before gravity is
    asked. Zero: it is known to be square."""


@dataclass(frozen=True)
class Settings:
    """What a method wants done by what all share."""

    method: str
    """Its name."""
    least_extent: float
    """Extent of the unit sphere, 2 for all of it, that must be seen in every direction."""
    remedy: str
    """What to do when the samples lie on no sphere."""
    options: TumblingOptions
    """The user's."""


def nominal_field(window: Window, knowledge: Knowledge) -> FloatArray:
    """Return the field (n, 3) with known gains and the nominal pose taken off, tesla."""
    return np.asarray(window.field @ knowledge.mounting.to_body.T)


def _refuse_flat(nominal: FloatArray) -> None:
    """Refuse a cloud that did not move, or that lies on a plane."""
    spread = np.linalg.svd(nominal - nominal.mean(axis=0), compute_uv=False)
    spread = spread / math.sqrt(len(nominal))
    if spread[0] < CLOUD.least_motion * float(np.median(np.linalg.norm(nominal, axis=1))):
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


def believed_strength(shape: Shape, knowledge: Knowledge) -> float:
    """Return the reference's strength where known, else the shape's own radius, tesla."""
    reference = knowledge.reference.strength
    return shape.radius if reference.is_unknown else reference.value


def believed_samples(distance: FloatArray) -> BoolArray:
    """Return which samples belong to the sphere.

    Parameters
    ----------
    distance : ndarray, shape (n,)
        From the unit sphere's centre.
    """
    off = np.abs(distance - float(np.median(distance)))
    gate = CLOUD.outlier_deviations * 1.4826 * float(np.median(off))
    return np.asarray(off <= max(gate, CLOUD.least_gate))


def finish(solve: Solve, window: Window, knowledge: Knowledge, settings: Settings) -> Estimate:
    """Judge a method's shape by its samples and put it into the common form.

    Parameters
    ----------
    solve : callable
        The method, from window and knowledge to a shape.
    window : Window
        The tumbling.
    knowledge : Knowledge
        Reference field and mounting.
    settings : Settings
        The method's own.

    Returns
    -------
    Estimate
        Without an installation. Besides the method's own figures: `misalignment` (rad, between
        the corrected field's axes and the IMU's as gravity shows it), `sphere_extent` (diameters
        seen in the least seen direction), `radius_ratio` where the strength is known.

    Raises
    ------
    Refusal
        If the samples cannot carry an answer.
    """
    options, nominal = settings.options, nominal_field(window, knowledge)
    refuse_empty(window, options.min_samples)
    _refuse_flat(nominal)
    shape = solve(window, knowledge)
    points = shape.on_sphere(nominal)
    inliers = believed_samples(np.linalg.norm(points, axis=1))
    extent = _refuse_no_sphere(points[inliers], settings)
    correction = shape.correction(knowledge)
    covariance = _covariance(solve, window, knowledge, options.jackknife_blocks)
    up = unit(window.specific_force[inliers])
    mounting = look_at_mounting(unit(points[inliers]), up, options.installation_sigma)
    strength = believed_strength(shape, knowledge)
    inclination = -math.asin(max(-1.0, min(1.0, mounting.cosine)))
    residual = window.field - correction.undo(strength * unit(points))
    noise = math.sqrt(float((residual[inliers] ** 2).sum()) / max(int(inliers.sum()) - 9, 1))
    return Estimate(
        method=settings.method,
        correction=correction,
        covariance=covariance + mounting.covariance_of(correction.matrix),
        installation=None,
        axis=np.array([0.0, 0.0, 1.0]),
        arc=2.0 * math.acos(max(-1.0, 1.0 - extent)),
        strength=strength,
        inclination=inclination,
        noise_field=noise,
        # The field's own noise is in the scatter, too: rather too large than too small.
        noise_up=mounting.scatter / max(math.cos(inclination), CLOUD.least_level_share),
        inliers=inliers,
        residual=residual,
        figures=_figures(shape, extent, mounting, knowledge, options),
        message="closed form; the magnetometer's axes were taken for the IMU's",
    )


def _covariance(solve: Solve, window: Window, knowledge: Knowledge, blocks: int) -> FloatArray:
    def fit_correction(part: Window, known: Knowledge) -> Correction:
        return solve(part, known).correction(known)

    return jackknife_covariance(fit_correction, window, knowledge, blocks)


def _figures(
    shape: Shape,
    extent: float,
    mounting: SeenMounting,
    knowledge: Knowledge,
    options: TumblingOptions,
) -> dict[Figure, float]:
    """Return the method's figures, and those that hold the result against what is known besides."""
    figures = {**shape.figures, Figure.SPHERE_EXTENT: 0.5 * extent}
    if options.installation_sigma > 0.0:
        figures[Figure.MISALIGNMENT] = mounting.angle
    if not knowledge.reference.strength.is_unknown:
        figures[Figure.RADIUS_RATIO] = shape.radius / believed_strength(shape, knowledge)
    return figures


def _refuse_no_sphere(points: FloatArray, settings: Settings) -> float:
    """Refuse what is no sphere; returns how far it reaches where it reaches least."""
    extent = float(np.ptp(unit(points) @ PROBES.T, axis=0).min())
    if extent < settings.least_extent:
        raise Refusal(
            Reason.ARC_TOO_SHORT,
            f"In one direction only {50.0 * extent:.0f}% of the sphere of orientations was seen; "
            f"at least {50.0 * settings.least_extent:.0f}% are needed. Tumble the sensor through "
            "all orientations, upside down included.",
        )
    rms = float(np.sqrt(np.mean((np.linalg.norm(points, axis=1) - 1.0) ** 2)))
    if rms > CLOUD.largest_residual:
        raise Refusal(
            Reason.NO_SOLUTION,
            f"The corrected samples miss the sphere by {100.0 * rms:.0f}% of its radius. "
            + settings.remedy,
        )
    return extent
