"""Everything else that the fit measured, by name: what a verdict is made of."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.attitude import field_in_enu
from magcal_ros.core.figures import heading_jacobian, rms_sigma
from magcal_ros.core.knowledge import Belief, Knowledge, ReferenceField
from magcal_ros.core.methods.maximum_likelihood.circle import fit_circle
from magcal_ros.core.methods.maximum_likelihood.covariance import (
    correction_from,
    correction_jacobian,
    inverse_information,
)
from magcal_ros.core.methods.maximum_likelihood.linearise import Weights, linearise
from magcal_ros.core.methods.maximum_likelihood.parameters import Globals
from magcal_ros.core.methods.maximum_likelihood.prior import prior_from
from magcal_ros.core.methods.maximum_likelihood.refine import Solution

FIGURES: Mapping[str, str] = MappingProxyType(
    {
        "heading_sigma": "predicted standard deviation of the heading on the level, radians",
        "heading_sigma_soft_iron": "the same if soft iron as large as believed were there unseen;"
        " far larger than heading_sigma where the turn could not have shown it, absent where soft"
        " iron was fitted or ruled out",
        "residual_ratio": "RMS of the believed samples' field residual over the level field",
        "inlier_fraction": "share of the samples that the fit believed",
        "radius_ratio": "radius of the turn's circle over the one that the known strength and"
        " inclination ask for; absent where one of them is unknown",
        "ellipse_ratio": "longer over shorter axis of the raw field's ellipse after the known"
        " gains; absent below three quarters of a turn",
        "split_half": "RMS difference of heading between the turn's halves, radians",
        "strength_pull": "strength found minus believed, in sigmas of the belief; absent where"
        " it was taken as exact or unknown",
        "inclination_pull": "the same for the inclination",
        "field_noise_ratio": "standard deviation of the field's noise over its strength",
        "up_noise": "standard deviation of up, radians",
        "kappa": "samples per independent sample, one or more",
        "wobble": "RMS lean of the turn's axis, radians per axis; zero for a rigid axis",
        "rival_gap": "heading between the solution and another that explains the samples as"
        " well, radians; zero without one",
        "soft_iron": "one where soft iron was fitted, else zero",
        "soft_iron_gain": "fall of chi-square by soft iron; zero where it was not tried",
        "gyro_carried": "one where the gyro carried the attitude from sample to sample, else zero;"
        " absent without a gyro",
        "gyro_compass_rms": "RMS of the lasting swing between the gyro's yaw and the corrected"
        " compass's: offset, bias, scale and the noise of single samples taken off; radians,"
        " absent without a gyro",
        "steady_pull": "lean of the accelerometer's up that was found to turn with the robot and"
        " was taken off, radians; zero without one; absent without a gyro",
        "field_scale": "tesla by which the field was scaled inside the fit",
    }
)
"""Names in `Estimate.figures`, and what they mean."""

LEAST_ELLIPSE_ARC = math.radians(270.0)


def measure_figures(
    solution: Solution, covariance: FloatArray, knowledge: Knowledge, scale: float, arc: float
) -> dict[str, float]:
    """Return the figures that the solution alone shows.

    Parameters
    ----------
    solution : Solution
    covariance : ndarray, shape (12, 12)
        Of the twelve numbers in SI units.
    knowledge : Knowledge
    scale : float
        Tesla of one field scale.
    arc : float
        Radians.
    """
    problem, shared = solution.problem, solution.state.shared
    believed = solution.believed
    jacobian = _level_heading_jacobian(solution, scale)
    lin = linearise(solution.state, problem)
    residual = lin.prediction.field_residual[believed]
    level = abs(shared.strength * math.cos(shared.inclination))
    figures = {
        "heading_sigma": rms_sigma(jacobian, covariance),
        "residual_ratio": math.sqrt(float(np.mean(np.sum(residual**2, axis=1)) / 3.0)) / level,
        "inlier_fraction": float(believed.mean()),
        "split_half": _split_half(solution, scale),
        "field_noise_ratio": problem.noise.field / abs(shared.strength),
        "up_noise": problem.noise.up,
        "kappa": problem.kappa,
        "wobble": 0.0 if problem.rigid else problem.noise.wobble,
        "soft_iron": float(problem.prior.has_soft_iron),
        "field_scale": scale,
    }
    figures.update(pulls(solution.state.shared, knowledge.reference, scale))
    figures.update(_unseen_soft_iron(solution, knowledge, scale))
    figures.update(_circle_figures(solution, knowledge, scale, arc))
    return figures


def _unseen_soft_iron(solution: Solution, knowledge: Knowledge, scale: float) -> dict[str, float]:
    prior = prior_from(knowledge, scale, soft_iron=True)
    if solution.problem.prior.has_soft_iron or not prior.has_soft_iron:
        return {}
    free = prior.free[prior.free >= solution.problem.prior.free[0]]
    problem = replace(solution.problem, prior=replace(prior, free=free))
    information = linearise(solution.state, problem).reduced_information
    jacobian = correction_jacobian(solution.state.shared, problem.samples.mounting, scale)
    by_global = _level_heading_jacobian(solution, scale) @ jacobian[:, free]
    covariance = problem.kappa * inverse_information(information)
    return {"heading_sigma_soft_iron": rms_sigma(by_global, covariance)}


def _level_heading_jacobian(solution: Solution, scale: float) -> FloatArray:
    """Return the derivative of the level heading by the twelve numbers, shape (24, 12)."""
    shared = solution.state.shared
    correction = correction_from(shared, solution.problem.samples.mounting, scale)
    field = field_in_enu(scale * shared.strength, shared.inclination)
    return heading_jacobian(correction, field, 0.0)


def _split_half(solution: Solution, scale: float) -> float:
    """Return the RMS heading between the optima of first and second half, one step away each."""
    problem = solution.problem
    count = len(problem.samples)
    moves = []
    for half in (np.arange(count) < count // 2, np.arange(count) >= count // 2):
        counted = problem.weights.sample * half
        weights = Weights(problem.weights.data, problem.weights.wobble, counted)
        lin = linearise(solution.state, problem.with_weights(weights))
        moves.append(lin.solve(1e-6, np.zeros(len(lin.gradient)))[0])
    jacobian = correction_jacobian(solution.state.shared, problem.samples.mounting, scale)
    by_global = _level_heading_jacobian(solution, scale) @ jacobian[:, problem.prior.free]
    gap = by_global @ (moves[0] - moves[1])
    return float(np.sqrt(np.mean(gap**2)))


def pulls(shared: Globals, reference: ReferenceField, scale: float) -> dict[str, float]:
    """Return by how many sigmas strength and inclination were pulled from what was believed."""
    pairs: list[tuple[str, Belief, float]] = [
        ("strength_pull", reference.strength, scale * shared.strength),
        ("inclination_pull", reference.inclination, shared.inclination),
    ]
    return {
        name: (found - belief.value) / belief.sigma
        for name, belief, found in pairs
        if not (belief.is_exact or belief.is_unknown)
    }


def _circle_figures(
    solution: Solution, knowledge: Knowledge, scale: float, arc: float
) -> dict[str, float]:
    samples, shared = solution.problem.samples, solution.state.shared
    points = samples.field[solution.believed] @ np.linalg.inv(samples.mounting).T
    circle = fit_circle(points)
    figures = {}
    if knowledge.reference.is_complete:
        across = np.cross(shared.world_axis[:, 2], shared.field_enu) / shared.strength
        strength = knowledge.reference.strength.value / scale
        expected = strength * float(np.linalg.norm(across))
        figures["radius_ratio"] = circle.radius / max(expected, 1e-9)
    if arc >= LEAST_ELLIPSE_ARC:
        figures["ellipse_ratio"] = ellipse_ratio(points, circle.centre, circle.normal)
    return figures


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
