"""From the optimum to what the caller sees."""

from __future__ import annotations

from dataclasses import dataclass

from magcal_ros.core.estimate import Estimate, Installation
from magcal_ros.core.methods.maximum_likelihood.covariance import (
    correction_from,
    correction_jacobian,
    inverse_information,
)
from magcal_ros.core.methods.maximum_likelihood.linearise import linearise
from magcal_ros.core.methods.maximum_likelihood.prepare import Prepared
from magcal_ros.core.methods.maximum_likelihood.refine import Solution
from magcal_ros.core.window import Window

METHOD = "maximum_likelihood"


@dataclass(frozen=True)
class Finding:
    rival_gap: float
    soft_iron_gain: float


def estimate_from(
    window: Window, prepared: Prepared, solution: Solution, finding: Finding
) -> Estimate:
    scale, samples, prior = prepared.scale, prepared.averaged, solution.problem.prior
    lin = linearise(solution.state, solution.problem)
    J = correction_jacobian(solution.state.shared, samples.mounting, scale)[:, prior.free]
    C = solution.problem.kappa * inverse_information(lin.reduced_information)
    sh = solution.state.shared
    return Estimate(
        METHOD,
        correction_from(sh, samples.mounting, scale),
        J @ C @ J.T,
        Installation(sh.roll, sh.pitch),
        sh.body_axis[:, 2],
        0.0,
        sh.strength * scale,
        sh.inclination,
        solution.problem.noise.field * scale,
        solution.problem.noise.up,
        solution.believed,
        lin.prediction.field_residual * scale,
        {
            "rigid": float(solution.problem.rigid),
            "wobble": solution.problem.noise.wobble,
            "kappa": solution.problem.kappa,
            "gain": finding.soft_iron_gain,
            "rival": finding.rival_gap,
            "iron": float(prior.has_soft_iron),
        },
    )
