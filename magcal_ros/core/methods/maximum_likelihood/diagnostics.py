"""Everything else that the fit measured, by name: what a verdict is made of."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import rms_sigma
from magcal_ros.core.estimation.free_attitude import FreeBlock
from magcal_ros.core.estimation.model import Evaluation, predict
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.estimation.prior import prior_from
from magcal_ros.core.estimation.solver import Fit
from magcal_ros.core.estimation.uncertainty import heading_by_twelve, level_heading_by_globals
from magcal_ros.core.estimation.weighting import Weights
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.circle3d import fit_circle_robustly
from magcal_ros.core.knowledge import Belief, Knowledge, ReferenceField


@dataclass(frozen=True)
class FigureTuning:
    """How the figures of one turn are measured."""

    ellipse_arc: float = math.radians(270.0)
    """Radians below which an arc shows no ellipse."""
    sector: float = math.radians(10.0)
    """Radians of the turn over which noise of up is averaged before it is graded."""
    split_damping: float = 1e-6
    """Of the step to the optimum of half a turn, which may leave a direction open."""


TUNING = FigureTuning()


def measure_figures(
    fit: Fit, covariance: FloatArray, knowledge: Knowledge, scale: float, arc: float
) -> dict[Figure, float]:
    """Return the figures that the optimum of one turn alone shows.

    Parameters
    ----------
    fit : Fit
    covariance : ndarray, shape (12, 12)
        Of the twelve numbers in SI units.
    knowledge : Knowledge
    scale : float
        Tesla of one field scale.
    arc : float
        Radians.
    """
    block, shared = fit.block, fit.shared
    weighting = block.weighting
    jacobian = heading_by_twelve(shared, fit.mounting, scale)
    residual = block.place.prediction.field_residual[weighting.inliers]
    level = abs(shared.strength * math.cos(shared.inclination))
    figures = {
        Figure.HEADING_SIGMA: rms_sigma(jacobian, covariance),
        Figure.RESIDUAL_RATIO: math.sqrt(float(np.mean(np.sum(residual**2, axis=1)) / 3.0)) / level,
        Figure.INLIER_FRACTION: float(weighting.inliers.mean()),
        Figure.SPLIT_HALF: _split_half(fit, scale),
        Figure.FIELD_NOISE_RATIO: weighting.noise.field / abs(shared.strength),
        Figure.UP_NOISE: weighting.noise.up * math.sqrt(min(_share_of_sector(fit, arc), 1.0)),
        Figure.KAPPA: weighting.inefficiency,
        Figure.WOBBLE: block.wobble,
        Figure.SOFT_IRON: float(fit.prior.has_soft_iron),
        Figure.FIELD_SCALE: scale,
    }
    figures.update(pulls(shared, knowledge.reference, scale))
    figures.update(_unseen_soft_iron(fit, knowledge, scale))
    figures.update(_circle_figures(fit, knowledge, scale, arc))
    return figures


def _share_of_sector(fit: Fit, arc: float) -> float:
    """Return what share of a sector of the turn one independent sample is.

    Noise that averages out over a sector tells the heading's sigma, and is no fault besides.
    """
    weighting = fit.block.weighting
    count = max(float(np.count_nonzero(weighting.inliers)), 1.0)
    return arc / TUNING.sector * weighting.inefficiency / count


def _unseen_soft_iron(fit: Fit, knowledge: Knowledge, scale: float) -> dict[Figure, float]:
    prior = prior_from(knowledge, scale, soft_iron=True)
    if fit.prior.has_soft_iron or not prior.has_soft_iron:
        return {}
    freed = replace(_with_free_attitudes(fit), prior=prior)
    sigma = rms_sigma(level_heading_by_globals(fit, scale), freed.covariance)
    return {Figure.HEADING_SIGMA_SOFT_IRON: sigma}


def _with_free_attitudes(fit: Fit) -> Fit:
    """Return the optimum with each sample free to turn by itself, which the gyro forbids."""
    block = fit.block
    if isinstance(block, FreeBlock):
        return fit
    noise = replace(block.weighting.noise, wobble=block.wobble)
    weighting = replace(block.weighting, noise=noise)
    return fit.with_blocks([FreeBlock(block.place, weighting, own=block.own)])


def _split_half(fit: Fit, scale: float) -> float:
    """Return the RMS heading between the optima of first and second half, one step away each."""
    free = _with_free_attitudes(fit)
    weights = free.block.weighting.weights
    count = len(weights.sample)
    steps = []
    for half in (np.arange(count) < count // 2, np.arange(count) >= count // 2):
        counted = Weights(weights.data, weights.wobble, weights.sample * half)
        equations = free.reweighted([counted]).equations
        move = equations.move(TUNING.split_damping, np.zeros(equations.size))
        if move is None:
            return math.nan
        steps.append(move.step[len(free.block.own) :])
    gap = level_heading_by_globals(fit, scale)[:, fit.free] @ (steps[0] - steps[1])
    return float(np.sqrt(np.mean(gap**2)))


def pulls(shared: Globals, reference: ReferenceField, scale: float) -> dict[Figure, float]:
    """Return by how many sigmas strength and inclination were pulled from what was believed."""
    pairs: list[tuple[Figure, Belief, float]] = [
        (Figure.STRENGTH_PULL, reference.strength, scale * shared.strength),
        (Figure.INCLINATION_PULL, reference.inclination, shared.inclination),
    ]
    return {
        name: (found - belief.value) / belief.sigma
        for name, belief, found in pairs
        if not (belief.is_exact or belief.is_unknown)
    }


def _circle_figures(
    fit: Fit, knowledge: Knowledge, scale: float, arc: float
) -> dict[Figure, float]:
    samples, shared = fit.block.samples, fit.shared
    points = _upright_field(fit.block.place)[fit.block.weighting.inliers]
    points = points @ np.linalg.inv(samples.mounting).T
    circle = fit_circle_robustly(points)
    figures = {}
    if knowledge.reference.is_complete:
        across = np.cross(shared.world_axis[:, 2], shared.field_enu) / shared.strength
        strength = knowledge.reference.strength.value / scale
        expected = strength * float(np.linalg.norm(across))
        figures[Figure.RADIUS_RATIO] = circle.radius / max(expected, 1e-9)
    if arc >= TUNING.ellipse_arc:
        figures[Figure.ELLIPSE_RATIO] = ellipse_ratio(points, circle.centre, circle.normal)
    return figures


def _upright_field(place: Evaluation) -> FloatArray:
    """Return the raw field (n, 3) as it would be had the axis not leaned from sample to sample.

    A robot that leans with the ground draws an ellipse of its own, which is no iron's.
    """
    upright = predict(place.state.upright(), place.samples).field_residual
    return np.asarray(place.samples.field + place.prediction.field_residual - upright)


def ellipse_ratio(points: FloatArray, centre: FloatArray, normal: FloatArray) -> float:
    """Return the ratio of the axes of the ellipse that points (n, 3) draw around a circle.

    The distance from the centre is fitted by a constant and its first two harmonics.
    """
    plane = np.linalg.svd(normal[None])[2][1:]
    x, y = plane @ (points - centre).T
    angle, distance = np.arctan2(y, x), np.hypot(x, y)
    columns = [np.ones_like(angle)]
    for order in (1, 2):
        columns += [np.cos(order * angle), np.sin(order * angle)]
    shape = np.linalg.lstsq(np.column_stack(columns), distance, rcond=None)[0]
    swing = min(math.hypot(shape[3], shape[4]) / max(float(shape[0]), 1e-12), 0.9)
    return (1.0 + swing) / (1.0 - swing)
