"""How uncertain a correction is, by fitting again without parts of the turn."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from magcal_ros.core.calibration.correction import PARAMETERS, Correction
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Belief, Knowledge
from magcal_ros.core.samples.window import Window

FEWEST_BLOCKS = 3

FitCorrection = Callable[[Window, Knowledge], Correction]


def jackknife_covariance(
    fit_correction: FitCorrection,
    window: Window,
    knowledge: Knowledge,
    blocks: int = 16,
    unknown: FloatArray | None = None,
) -> FloatArray:
    """Return the covariance of a method's twelve numbers.

    Sum of three parts: the spread of the fits that each leave out one piece of time,
    (g - 1)/g Σ (p_k - mean)(p_k - mean)ᵀ over g pieces (Tukey's jackknife, in blocks so that
    neighbours' common errors count, Künsch 1989); the shift of the fit when the strength or the
    inclination of the reference moves by its own sigma; and what the caller knows to be unseen.

    Parameters
    ----------
    fit_correction : callable
        The method, from a window and the knowledge to a correction.
    window : Window
        The turn.
    knowledge : Knowledge
        What the method was given.
    blocks : int
        Number of pieces; fewer are taken when there are fewer samples.
    unknown : array_like, shape (12,), optional
        One standard deviation along a direction that the turn does not show.

    Returns
    -------
    ndarray, shape (12, 12)
        A row by row (dimensionless), then h (tesla).

    Raises
    ------
    Refusal
        If the whole window, a moved reference, or more than half of the shortened windows have
        no answer.
    """
    covariance = _blocks_covariance(fit_correction, window, knowledge, blocks)
    covariance = covariance + _reference_covariance(fit_correction, window, knowledge)
    if unknown is not None:
        covariance = covariance + np.outer(unknown, unknown)
    return np.asarray(0.5 * (covariance + covariance.T))


def _blocks_covariance(
    fit_correction: FitCorrection, window: Window, knowledge: Knowledge, blocks: int
) -> FloatArray:
    pieces = np.array_split(np.arange(len(window)), min(max(blocks, FEWEST_BLOCKS), len(window)))
    answers = []
    for piece in pieces:
        shortened = window.take(np.delete(np.arange(len(window)), piece))
        with contextlib.suppress(Refusal):
            answers.append(fit_correction(shortened, knowledge).parameters)
    if len(answers) <= len(pieces) // 2 or len(answers) < FEWEST_BLOCKS:
        raise Refusal(
            Reason.NO_SOLUTION,
            "The answer hangs on single pieces of the turn: without them there is none. Turn "
            "further round, or again.",
        )
    deviations = np.array(answers) - np.mean(answers, axis=0)
    # A piece without an answer is worth at least an average one.
    scale = (len(answers) - 1) / len(answers) * len(pieces) / len(answers)
    return np.asarray(scale * deviations.T @ deviations)


def _reference_covariance(
    fit_correction: FitCorrection, window: Window, knowledge: Knowledge
) -> FloatArray:
    covariance = np.zeros((PARAMETERS, PARAMETERS))
    moved = _moved_references(knowledge)
    if not moved:
        return covariance
    centre = fit_correction(window, knowledge).parameters
    for other in moved:
        shift = fit_correction(window, other).parameters - centre
        covariance += np.outer(shift, shift)
    return covariance


def _moved_references(knowledge: Knowledge) -> list[Knowledge]:
    reference = knowledge.reference
    moved = (
        replace(reference, strength=_one_sigma_up(reference.strength)),
        replace(reference, inclination=_one_sigma_up(reference.inclination)),
    )
    return [replace(knowledge, reference=other) for other in moved if other != reference]


def _one_sigma_up(belief: Belief) -> Belief:
    return belief if belief.is_unknown else Belief(belief.value + belief.sigma, belief.sigma)
