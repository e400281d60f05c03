"""From a window to an estimate: the walk through the other files."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.estimate import Estimate
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.maximum_likelihood.attitudes import attitudes_from_vectors
from magcal_ros.core.methods.maximum_likelihood.carried import (
    Carried,
    choose_carried,
    explains_as_well,
)
from magcal_ros.core.methods.maximum_likelihood.choice import choose_model
from magcal_ros.core.methods.maximum_likelihood.consistency import gyro_compass_rms
from magcal_ros.core.methods.maximum_likelihood.doubt import Doubt
from magcal_ros.core.methods.maximum_likelihood.figures import measure_figures
from magcal_ros.core.methods.maximum_likelihood.gyro import (
    Carrier,
    carry,
    sense_of_mounting,
)
from magcal_ros.core.methods.maximum_likelihood.linearise import Weights, linearise
from magcal_ros.core.methods.maximum_likelihood.model import Samples, State
from magcal_ros.core.methods.maximum_likelihood.prepare import Prepared, prepare
from magcal_ros.core.methods.maximum_likelihood.prior import prior_from
from magcal_ros.core.methods.maximum_likelihood.refine import Solution, converged
from magcal_ros.core.methods.maximum_likelihood.report import build_estimate, twelve_covariance
from magcal_ros.core.methods.maximum_likelihood.screening import (
    check_gyro,
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
    return conclude(solve(window, knowledge, options), knowledge)


def solve(
    window: Window, knowledge: Knowledge = Knowledge(), options: Options = Options()
) -> Solved:
    """Find the optimum of one turn, before it is asked whether the turn can carry it.

    Raises
    ------
    Refusal
        If there is nothing to be found in the samples.
    """
    check_window(window, knowledge)
    prepared = prepare(window.field, window.specific_force, knowledge, options.largest)
    return _solve(window, prepared, knowledge)


def conclude(outcome: Solved, knowledge: Knowledge) -> Estimate:
    """Check an optimum and bring it into the package's own form.

    Raises
    ------
    Refusal
        If the turn cannot carry a calibration.
    """
    solution, prepared = outcome.solution, outcome.prepared
    arc = seen_arc(solution.state, solution.believed)
    gyro = outcome.gyro_compass_rms is not None
    if outcome.gyro_compass_rms is not None:
        check_gyro(outcome.gyro_compass_rms)
    check_solution(solution, knowledge, arc, outcome.rival_gap, gyro=gyro)
    covariance = twelve_covariance(solution, outcome.information, prepared.scale, outcome.doubt)
    figures = measure_figures(solution, covariance, knowledge, prepared.scale, arc)
    figures.update(rival_gap=outcome.rival_gap, soft_iron_gain=outcome.soft_iron_gain)
    if outcome.gyro_compass_rms is not None:
        figures.update(
            gyro_carried=float(outcome.carried is not None),
            gyro_compass_rms=outcome.gyro_compass_rms,
            steady_pull=outcome.steady_pull,
        )
    return build_estimate(solution, prepared, covariance, arc, figures)


@dataclass(frozen=True, eq=False)
class Solved:
    """What the fit came to, before anything is believed."""

    prepared: Prepared
    solution: Solution
    information: FloatArray
    rival_gap: float
    soft_iron_gain: float
    doubt: Doubt | None
    carried: Carried | None = None
    gyro_compass_rms: float | None = None

    @property
    def steady_pull(self) -> float:
        """Steady pull that was taken off the accelerometer, radians."""
        return 0.0 if self.carried is None else float(np.linalg.norm(self.carried.offset))


def _solve(window: Window, prepared: Prepared, knowledge: Knowledge) -> Solved:
    samples, scale = prepared.averaged, prepared.scale
    without_iron = prior_from(knowledge, scale, soft_iron=False)
    with_iron = prior_from(knowledge, scale, soft_iron=True)
    carrier = None if window.angular_rate is None else carry(window, prepared.first)
    sense = 1.0 if carrier is None else sense_of_mounting(samples, carrier)
    found = search(starts(samples, knowledge.reference, scale, sense), samples, without_iron)
    everyone = _on_all(found.best, samples)
    always = knowledge.soft_iron.always
    if carrier is not None:
        carried = choose_carried(everyone, carrier, with_iron, always_iron=always)
        if explains_as_well(carried.best, found.best):
            return Solved(
                prepared,
                carried.best.solution,
                carried.best.information,
                found.rival_gap,
                carried.soft_iron_gain,
                carried.doubt,
                carried=carried.best,
                gyro_compass_rms=_consistency(
                    carried.best.solution, carrier, prepared, window, carried.best.offset
                ),
            )
    choice = choose_model(everyone, with_iron, always_iron=always)
    solution = converged(choice.solution)
    information = linearise(solution.state, solution.problem).reduced_information
    consistency = None if carrier is None else _consistency(solution, carrier, prepared, window)
    return Solved(
        prepared,
        solution,
        information,
        found.rival_gap,
        choice.soft_iron_gain,
        choice.doubt,
        gyro_compass_rms=consistency,
    )


def _consistency(
    solution: Solution,
    carrier: Carrier,
    prepared: Prepared,
    window: Window,
    offset: FloatArray | None = None,
) -> float:
    samples = prepared.averaged
    if offset is not None:
        samples = replace(samples, up=samples.up - offset)
    shared = solution.state.shared
    attitude = shared.body_axis @ attitudes_from_vectors(shared, samples)
    return gyro_compass_rms(carrier.relative, attitude, window.time[prepared.first])


def _on_all(thin: Solution, samples: Samples) -> Solution:
    """Carry a solution from thinned samples to all of them."""
    shared = thin.state.shared
    state = State(shared, attitudes_from_vectors(shared, samples))
    weights = Weights.ones(len(samples))
    return Solution(state, replace(thin.problem, samples=samples, weights=weights))
