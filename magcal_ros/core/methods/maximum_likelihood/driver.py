"""From a window to an estimate: the walk through the other files."""

from __future__ import annotations

from dataclasses import dataclass, replace

from magcal_ros.core.estimate import Estimate
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.maximum_likelihood.attitudes import attitudes_from_vectors
from magcal_ros.core.methods.maximum_likelihood.choice import choose_model
from magcal_ros.core.methods.maximum_likelihood.linearise import Weights
from magcal_ros.core.methods.maximum_likelihood.model import State
from magcal_ros.core.methods.maximum_likelihood.prepare import prepare
from magcal_ros.core.methods.maximum_likelihood.prior import prior_from
from magcal_ros.core.methods.maximum_likelihood.refine import Solution, converged
from magcal_ros.core.methods.maximum_likelihood.report import Finding, estimate_from
from magcal_ros.core.methods.maximum_likelihood.search import search
from magcal_ros.core.methods.maximum_likelihood.starts import starts
from magcal_ros.core.window import Window


@dataclass(frozen=True)
class Options:
    """How the fit works; the defaults are meant to be left alone.

    Parameters
    ----------
    largest : int
        Neighbouring samples are averaged until no more than this number remain.
    """

    largest: int = 800


def fit(
    window: Window, knowledge: Knowledge = Knowledge(), options: Options = Options()
) -> Estimate:
    prepared = prepare(window.field, window.specific_force, knowledge, options.largest)
    samples = prepared.averaged
    prior = prior_from(knowledge, prepared.scale, soft_iron=False)
    with_iron = prior_from(knowledge, prepared.scale, soft_iron=True)
    guesses = starts(samples, knowledge.reference, prepared.scale, 1.0)
    found = search(guesses, samples, prior)
    best = found.best
    state = State(best.state.shared, attitudes_from_vectors(best.state.shared, samples))
    problem = replace(best.problem, samples=samples, weights=Weights.ones(len(samples)))
    choice = choose_model(
        Solution(state, problem), with_iron, always_iron=knowledge.soft_iron.always
    )
    solution = converged(choice.solution)
    return estimate_from(
        window, prepared, solution, Finding(found.rival_gap, choice.soft_iron_gain)
    )
