"""The covariance of a correction, by a jackknife over parts of the turn."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Belief, Knowledge
from magcal_ros.core.samples.window import Window

BLOCKS = 16

FitCorrection = Callable[[Window, Knowledge], Correction]


def jackknife_covariance(
    fit_correction: FitCorrection,
    window: Window,
    knowledge: Knowledge,
    unknown: FloatArray | None = None,
) -> FloatArray:
    """Return the covariance (12, 12) of a method's twelve numbers, A row by row, then h in tesla.

    It is the sum of three parts. The first is the spread of fits that each leave out one of g
    pieces of time, (g - 1)/g Σ (p_k - mean)(p_k - mean)ᵀ (Tukey's jackknife; in blocks because
    neighbours are correlated, Künsch 1989). The second is the shift of the fit if strength or
    inclination of the reference change by one sigma. The third is `unknown` (12,), one sigma along
    an unobservable direction.

    Raises `Refusal` if the whole window, a moved reference, or more than half of the shortened
    windows have no answer.
    """
    covariance = _blocks_covariance(fit_correction, window, knowledge)
    if unknown is not None:
        covariance += np.outer(unknown, unknown)
    reference = knowledge.reference
    moved = [
        replace(reference, strength=_one_sigma_up(reference.strength)),
        replace(reference, inclination=_one_sigma_up(reference.inclination)),
    ]
    centre = fit_correction(window, knowledge).parameters
    for other in moved:
        if other != reference:
            known = replace(knowledge, reference=other)
            shift = fit_correction(window, known).parameters - centre
            covariance += np.outer(shift, shift)
    return np.asarray(0.5 * (covariance + covariance.T))


def _blocks_covariance(
    fit_correction: FitCorrection, window: Window, knowledge: Knowledge
) -> FloatArray:
    pieces = np.array_split(np.arange(len(window)), BLOCKS)
    answers = []
    for piece in pieces:
        shortened = window.take(np.delete(np.arange(len(window)), piece))
        with contextlib.suppress(Refusal):
            answers.append(fit_correction(shortened, knowledge).parameters)
    if len(answers) <= len(pieces) // 2:
        raise Refusal(
            Reason.NO_SOLUTION,
            "Without some parts of the turn there is no solution. Turn further, or once more.",
        )
    deviations = np.array(answers) - np.mean(answers, axis=0)
    # A piece without an answer counts as an average one.
    scale = (len(answers) - 1) / len(answers) * len(pieces) / len(answers)
    return np.asarray(scale * deviations.T @ deviations)


def _one_sigma_up(belief: Belief) -> Belief:
    return belief if belief.is_unknown else Belief(belief.value + belief.sigma, belief.sigma)
