"""From the optimum to what the caller sees."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.estimate import Estimate, GyroSwing, Installation
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.estimation.averaging import Prepared
from magcal_ros.core.estimation.block import TurnBlock
from magcal_ros.core.estimation.free_attitude import FreeBlock
from magcal_ros.core.estimation.solver import Fit, Status
from magcal_ros.core.estimation.uncertainty import correction_from
from magcal_ros.core.estimation.weighting import Noise
from magcal_ros.core.estimation.weights import passes_alone
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray

METHOD = "maximum_likelihood"


@dataclass(frozen=True, eq=False)
class EstimateParts:
    """What belongs to an estimate beside the optimum."""

    prepared: Prepared
    """The samples."""
    covariance: FloatArray
    """Of the twelve numbers in SI units. Shape (12, 12)."""
    axis: FloatArray
    """The turn's axis in body axes. Shape (3,)."""
    arc: float
    """Radians."""
    figures: dict[Figure, float]
    swing: GyroSwing | None
    """Of gyro and compass over the turn."""


def build_estimate(fit: Fit, parts: EstimateParts) -> Estimate:
    """Put the numbers into the package's own form."""
    shared, prepared = fit.shared, parts.prepared
    scale, noise = prepared.scale, fit.block.weighting.noise
    inliers, residual = samples_inliers(fit.block, prepared)
    # The noise of one sample; the fit may be on averages.
    single = math.sqrt(prepared.width)
    return Estimate(
        method=METHOD,
        correction=correction_from(shared, fit.mounting, scale),
        covariance=parts.covariance,
        installation=Installation(shared.roll, shared.pitch, shared.yaw),
        axis=parts.axis,
        arc=parts.arc,
        strength=scale * shared.strength,
        inclination=shared.inclination,
        noise_field=scale * single * noise.field,
        noise_up=single * noise.up,
        inliers=inliers,
        residual=scale * residual,
        figures=parts.figures | convergence_figures(fit),
        message=message(fit),
        swing=parts.swing,
    )


def samples_inliers(block: TurnBlock, prepared: Prepared) -> tuple[BoolArray, FloatArray]:
    """Return which rows of the window the fit counted (n,), and their residuals (n, 3)."""
    if prepared.all is prepared.averaged:
        return block.weighting.inliers, block.place.prediction.field_residual
    width, noise = float(np.sqrt(prepared.width)), block.weighting.noise
    wobble = block.wobble if block.wobble > 0.0 else noise.wobble
    single = Noise(noise.up * width, noise.field * width, wobble)
    rigid = isinstance(block, FreeBlock) and not block.leans
    free = FreeBlock(block.place, block.weighting, leans=not rigid)
    each = free.following(prepared.all, single)
    lengths = np.diff(np.append(prepared.first, len(prepared.all)))
    inliers = np.repeat(block.weighting.inliers, lengths) & passes_alone(each.chi)
    return inliers, each.place.prediction.field_residual


def convergence_figures(fit: Fit) -> dict[Figure, float]:
    """Return how the optimisation ended, by name."""
    return {
        Figure.NOT_CONVERGED: float(fit.convergence.status is not Status.CONVERGED),
        Figure.ITERATIONS: float(fit.convergence.iterations),
        Figure.PREDICTED_DECREASE: fit.convergence.decrease,
    }


def message(fit: Fit) -> str:
    """Say why the fit ended, and on which model."""
    iron = "with soft iron" if fit.prior.has_soft_iron else "without soft iron"
    axis = "a wobbling axis" if fit.block.leans else "a rigid axis"
    if not isinstance(fit.block, FreeBlock):
        axis = "the gyro's attitude"
    return f"{fit.convergence.status.value} on {axis}, {iron}"
