"""From a window to an estimate: the walk through the other files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.attitude import unit
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.estimate import Estimate, Installation
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.maximum_likelihood import parameters as p
from magcal_ros.core.methods.maximum_likelihood.choice import evidence, soft_evidence
from magcal_ros.core.methods.maximum_likelihood.covariance import (
    correction_from,
    correction_jacobian,
    inverse_information,
)
from magcal_ros.core.methods.maximum_likelihood.linearise import linearise
from magcal_ros.core.methods.maximum_likelihood.model import Samples
from magcal_ros.core.methods.maximum_likelihood.prior import Prior, prior_from
from magcal_ros.core.methods.maximum_likelihood.refine import (
    Solution,
    anneal,
    first_steps,
    gated,
)
from magcal_ros.core.methods.maximum_likelihood.starts import starts
from magcal_ros.core.window import Window

METHOD = "maximum_likelihood"


@dataclass(frozen=True)
class Options:
    pass


def fit(window: Window, knowledge: Knowledge = Knowledge(), options: Options = Options()) -> Estimate:
    scale = 50e-6 if knowledge.reference.strength.is_unknown else knowledge.reference.strength.value
    samples = Samples(unit(window.specific_force), window.field / scale, knowledge.mounting.matrix)
    prior = prior_from(knowledge, scale, soft_iron=False)
    cands = sorted(
        (first_steps(s, samples, prior) for s in starts(samples, knowledge.reference, scale, 1.0)),
        key=lambda t: t[0],
    )
    sols = [anneal(s, samples, prior) for _, s in cands[:2]]
    sols.sort(key=soft_evidence)
    wob = gated(sols[0])
    from dataclasses import replace
    from magcal_ros.core.methods.maximum_likelihood.linearise import Noise
    n0 = wob.problem.noise
    rig = gated(Solution(wob.state.upright(), replace(wob.problem, rigid=True, noise=Noise(np.hypot(n0.up, n0.wobble), n0.field, n0.wobble))))
    common = wob.believed & rig.believed
    k = wob.problem.kappa
    ew, er = evidence(wob, common, k), evidence(rig, common, k)
    best = rig if er <= ew + 4 * k else wob
    lin = linearise(best.state, best.problem)
    J = correction_jacobian(best.state.shared, samples.mounting, scale)[:, prior.free]
    C = best.problem.kappa * inverse_information(lin.reduced_information)
    sh = best.state.shared
    return Estimate(METHOD, correction_from(sh, samples.mounting, scale), J @ C @ J.T,
        Installation(sh.roll, sh.pitch), sh.body_axis[:, 2], 0.0, sh.strength*scale, sh.inclination,
        best.problem.noise.field*scale, best.problem.noise.up, best.believed, lin.prediction.field_residual*scale,
        {"rigid": float(best.problem.rigid), "wobble": best.problem.noise.wobble, "kappa": best.problem.kappa, "ew": ew, "er": er})
