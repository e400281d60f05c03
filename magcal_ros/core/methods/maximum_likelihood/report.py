"""From the optimum to what the caller sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magcal_ros.core.arrays import BoolArray, FloatArray
from magcal_ros.core.estimate import Estimate, Installation
from magcal_ros.core.methods.maximum_likelihood import parameters as p
from magcal_ros.core.methods.maximum_likelihood.attitudes import follow
from magcal_ros.core.methods.maximum_likelihood.bend import bend_of_hard_iron
from magcal_ros.core.methods.maximum_likelihood.covariance import (
    correction_from,
    correction_jacobian,
    inverse_information,
)
from magcal_ros.core.methods.maximum_likelihood.doubt import Doubt
from magcal_ros.core.methods.maximum_likelihood.linearise import Noise, chi_squares
from magcal_ros.core.methods.maximum_likelihood.model import predict
from magcal_ros.core.methods.maximum_likelihood.prepare import Prepared
from magcal_ros.core.methods.maximum_likelihood.refine import Solution
from magcal_ros.core.methods.maximum_likelihood.weights import passes_alone

METHOD = "maximum_likelihood"


def twelve_covariance(
    solution: Solution, information: FloatArray, scale: float, doubt: Doubt | None = None
) -> FloatArray:
    """Return the covariance of the twelve numbers in SI units, shape (12, 12).

    Parameters
    ----------
    solution : Solution
    information : ndarray, shape (g, g)
        On the free globals, prior times kappa included.
    scale : float
        Tesla of one field scale.
    doubt : Doubt, optional
        Of soft iron that was not fitted.
    """
    problem = solution.problem
    jacobian = correction_jacobian(solution.state.shared, problem.samples.mounting, scale)
    free = problem.prior.free
    of_globals = np.zeros((p.COUNT, p.COUNT))
    of_globals[np.ix_(free, free)] = problem.kappa * inverse_information(information)
    covariance = jacobian @ of_globals @ jacobian.T
    covariance[9:, 9:] += scale**2 * bend_of_hard_iron(
        solution.state.shared, _mean_turn(solution), problem.samples.mounting, of_globals
    )
    if doubt is not None:
        covariance = doubt.widened(covariance, jacobian)
    return np.asarray(0.5 * (covariance + covariance.T))


def _mean_turn(solution: Solution) -> FloatArray:
    return np.asarray(solution.state.attitude[solution.believed].mean(axis=0))


def build_estimate(
    solution: Solution,
    prepared: Prepared,
    covariance: FloatArray,
    arc: float,
    figures: dict[str, float],
) -> Estimate:
    """Put the numbers into the package's own form."""
    shared, noise, scale = solution.state.shared, solution.problem.noise, prepared.scale
    believed, residual = samples_believed(solution, prepared)
    width = prepared.width
    return Estimate(
        method=METHOD,
        correction=correction_from(shared, prepared.all.mounting, scale),
        covariance=covariance,
        installation=Installation(shared.roll, shared.pitch, shared.yaw),
        axis=shared.body_axis[:, 2],
        arc=arc,
        strength=scale * shared.strength,
        inclination=shared.inclination,
        noise_field=scale * noise.field * float(np.sqrt(width)),
        noise_up=noise.up * float(np.sqrt(width)),
        inliers=believed,
        residual=scale * residual,
        figures=figures,
        message=_message(solution, figures),
    )


def samples_believed(solution: Solution, prepared: Prepared) -> tuple[BoolArray, FloatArray]:
    """Return which rows of the window the fit believed (n,), and their residuals (n, 3)."""
    if prepared.all is prepared.averaged:
        residual = predict(solution.state, prepared.all).field_residual
        return solution.believed, residual
    width = float(np.sqrt(prepared.width))
    noise = solution.problem.noise
    single = Noise(noise.up * width, noise.field * width, noise.wobble)
    problem = replace(solution.problem, noise=single)
    state = follow(solution.state.shared, problem, prepared.all)
    prediction = predict(state, prepared.all)
    chi = chi_squares(state, prediction, single)
    lengths = np.diff(np.append(prepared.first, len(prepared.all)))
    stretch = np.repeat(solution.believed, lengths)
    return stretch & passes_alone(chi), prediction.field_residual


def _message(solution: Solution, figures: dict[str, float]) -> str:
    axis = "a rigid axis" if solution.problem.rigid else "a wobbling axis"
    if figures.get("gyro_carried"):
        axis = "the gyro's attitude"
    iron = "with soft iron" if solution.problem.prior.has_soft_iron else "without soft iron"
    return f"converged on {axis}, {iron}"
