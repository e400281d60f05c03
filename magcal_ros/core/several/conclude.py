"""From the joint optimum to the package's own form: the estimate and its figures."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.estimate import Estimate, Installation
from magcal_ros.core.figures import rms_sigma
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.maximum_likelihood import parameters as p
from magcal_ros.core.methods.maximum_likelihood.covariance import correction_from
from magcal_ros.core.methods.maximum_likelihood.figures import pulls
from magcal_ros.core.methods.maximum_likelihood.model import predict
from magcal_ros.core.methods.maximum_likelihood.refine import Solution
from magcal_ros.core.methods.maximum_likelihood.report import METHOD, samples_believed
from magcal_ros.core.methods.maximum_likelihood.screening import seen_arc
from magcal_ros.core.several.fit import JointFit
from magcal_ros.core.several.observability import heading_jacobians, relative
from magcal_ros.core.several.survey import Turn

WORST_IS_LARGEST = (
    "gyro_compass_rms",
    "field_noise_ratio",
    "up_noise",
    "kappa",
    "wobble",
    "steady_pull",
)
WORST_IS_SMALLEST = ("inlier_fraction", "gyro_carried")
"""Figures of the turns' own fits of which the worst speaks for all."""


def joint_estimate(fit: JointFit, turns: Sequence[Turn], knowledge: Knowledge) -> Estimate:
    """Put a joint fit into the form that every method returns.

    Parameters
    ----------
    fit : JointFit
    turns : sequence of Turn
        In the order of the fit's blocks. Inliers and residuals are those of the last.
    knowledge : Knowledge

    Returns
    -------
    Estimate
        `figures["heading_sigma"]` and its tilted twin leave out the offset that all headings
        have in common, as one turn's do; `installation_yaw_sigma` is that offset's.
    """
    shared, scale = fit.joint.shared, fit.scale
    blocks, solved = fit.joint.blocks, turns[-1].solved
    assert solved is not None
    newest = Solution(blocks[-1].state, blocks[-1].problem)
    believed, residual = samples_believed(newest, solved.prepared)
    covariance = fit.covariance
    return Estimate(
        method=METHOD,
        correction=correction_from(shared, fit.joint.mounting, scale),
        covariance=0.5 * (covariance + covariance.T),
        installation=Installation(shared.roll, shared.pitch, shared.yaw),
        axis=solved.solution.state.shared.body_axis[:, 2],
        arc=max(_arc(turn) for turn in turns),
        strength=scale * shared.strength,
        inclination=shared.inclination,
        noise_field=scale * _single_noise([block.problem.noise.field for block in blocks], turns),
        noise_up=_single_noise([block.problem.noise.up for block in blocks], turns),
        inliers=believed,
        residual=scale * residual,
        figures=_figures(fit, turns, knowledge, covariance),
        message=f"{len(turns)} turns converged together, "
        f"{'with' if fit.joint.prior.has_soft_iron else 'without'} soft iron",
    )


def _single_noise(sigmas: list[float], turns: Sequence[Turn]) -> float:
    """Return the noise of one sample over all turns; some were fitted on averages."""
    widths = [t.solved.prepared.width for t in turns if t.solved is not None]
    squares = [width * sigma**2 for width, sigma in zip(widths, sigmas, strict=True)]
    return math.sqrt(float(np.mean(squares)))


def _arc(turn: Turn) -> float:
    assert turn.solved is not None
    return seen_arc(turn.solved.solution.state, turn.solved.solution.believed)


def _figures(
    fit: JointFit, turns: Sequence[Turn], knowledge: Knowledge, covariance: FloatArray
) -> dict[str, float]:
    shared, scale = fit.joint.shared, fit.scale
    level, tilted = heading_jacobians(shared, fit.joint.mounting, scale)
    worst = max(fit.agreements, key=lambda agreement: -agreement.chance)
    figures = _worst_of(turns) | {
        "heading_sigma": rms_sigma(relative(level, level), covariance),
        "heading_sigma_tilted": rms_sigma(relative(tilted, level), covariance),
        "residual_ratio": _residual_ratio(fit),
        "samples": float(sum(b.problem.weights.sample.sum() for b in fit.joint.blocks)),
        "soft_iron": float(fit.joint.prior.has_soft_iron),
        "soft_iron_gain": fit.soft_iron_gain,
        "field_scale": scale,
        "turns": float(len(turns)),
        "turn_misfit": worst.misfit,
    }
    if fit.shows_yaw:
        sigma = math.sqrt(fit.widening * float(fit.joint.covariance[p.YAW, p.YAW]))
        figures["installation_yaw_sigma"] = sigma
    return figures | pulls(shared, knowledge.reference, scale)


def _worst_of(turns: Sequence[Turn]) -> dict[str, float]:
    """Return the worst of the turns' own figures, of those that could stand alone."""
    own = [turn.outcome.estimate.figures for turn in turns if turn.outcome.estimate is not None]
    figures = {}
    for names, worst in ((WORST_IS_LARGEST, max), (WORST_IS_SMALLEST, min)):
        for name in names:
            values = [each[name] for each in own if name in each]
            if values:
                figures[name] = worst(values)
    return figures


def _residual_ratio(fit: JointFit) -> float:
    """Return the RMS residual of the believed samples of all turns over the level field."""
    squares, shared = [], fit.joint.shared
    for block in fit.joint.blocks:
        residual = predict(block.state, block.problem.samples).field_residual
        squares.append(residual[block.problem.weights.sample > 0.5] ** 2)
    level = abs(shared.strength * math.cos(shared.inclination))
    return math.sqrt(float(np.mean(np.vstack(squares)))) / level
