"""From a window to an estimate: the walk through the other files."""

from __future__ import annotations

from dataclasses import dataclass, replace

from magcal_ros.core.estimate import Estimate
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.maximum_likelihood.attitudes import attitudes_from_vectors
from magcal_ros.core.methods.maximum_likelihood.choice import choose_model
from magcal_ros.core.methods.maximum_likelihood.figures import measure_figures
from magcal_ros.core.methods.maximum_likelihood.linearise import Weights, linearise
from magcal_ros.core.methods.maximum_likelihood.model import Samples, State
from magcal_ros.core.methods.maximum_likelihood.prepare import prepare
from magcal_ros.core.methods.maximum_likelihood.prior import prior_from
from magcal_ros.core.methods.maximum_likelihood.refine import Solution, converged
from magcal_ros.core.methods.maximum_likelihood.report import build_estimate, twelve_covariance
from magcal_ros.core.methods.maximum_likelihood.screening import (
    check_solution,
    check_window,
    seen_arc,
)
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
    """Find installation error and hard iron from one turn by maximum likelihood.

    Parameters
    ----------
    window : Window
        Paired samples of the turn.
    knowledge : Knowledge
        Reference field, mounting and soft iron, each known, uncertain or unknown.
    options : Options

    Returns
    -------
    Estimate
        Its `figures` are explained in `figures.FIGURES`.

    Raises
    ------
    Refusal
        If the samples cannot carry a calibration; the message says what to do next.
    """
    check_window(window, knowledge)
    prepared = prepare(window.field, window.specific_force, knowledge, options.largest)
    samples, scale = prepared.averaged, prepared.scale
    without_iron = prior_from(knowledge, scale, soft_iron=False)
    with_iron = prior_from(knowledge, scale, soft_iron=True)
    found = search(starts(samples, knowledge.reference, scale, 1.0), samples, without_iron)
    everyone = _on_all(found.best, samples)
    choice = choose_model(everyone, with_iron, always_iron=knowledge.soft_iron.always)
    solution = converged(choice.solution)
    arc = seen_arc(solution.state, solution.believed)
    check_solution(solution, knowledge, arc, found.rival_gap, gyro=False)
    information = linearise(solution.state, solution.problem).reduced_information
    covariance = twelve_covariance(solution, information, scale)
    figures = measure_figures(solution, covariance, knowledge, scale, arc)
    figures.update(rival_gap=found.rival_gap, soft_iron_gain=choice.soft_iron_gain)
    return build_estimate(solution, prepared, covariance, arc, figures)


def _on_all(thin: Solution, samples: Samples) -> Solution:
    """Carry a solution from thinned samples to all of them."""
    shared = thin.state.shared
    state = State(shared, attitudes_from_vectors(shared, samples))
    weights = Weights.ones(len(samples))
    return Solution(state, replace(thin.problem, samples=samples, weights=weights))
