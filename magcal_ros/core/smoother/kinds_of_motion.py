"""On the spot, in a small circle, or a drive: each kind of motion is fitted and weighed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.factors import soft_iron
from magcal_ros.core.smoother.fit import Fit, fit
from magcal_ros.core.smoother.nodes import Nodes, nodes_of
from magcal_ros.core.smoother.posterior import Posterior, posterior
from magcal_ros.core.smoother.start import start
from magcal_ros.core.smoother.state import State
from magcal_ros.core.smoother.unknowns import KINDS, Priors, priors_of

BELIEVED = 0.25
"""Of the evidence, which is minus twice a logarithm; exact evidence would count by a half.

It is approximate (Laplace, at the most likely sizes), and real robots differ from the model."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """What a window came to.

    Parameters
    ----------
    nodes : Nodes
    mode : str
        The most likely kind of motion.
    fits : dict of str to Fit
        By kind of motion.
    weights : dict of str to float
        Their probabilities.
    posterior : Posterior
        Of the most likely kind; the others are in its covariance.
    """

    nodes: Nodes
    mode: str
    fits: dict[str, Fit]
    weights: dict[str, float]
    posterior: Posterior

    @property
    def fit(self) -> Fit:
        """The fit of the most likely kind of motion."""
        return self.fits[self.mode]


def smooth(window: Window, knowledge: Knowledge) -> Smoothed:
    """Fit a window for each kind of motion and weigh the answers by their evidence.

    Parameters
    ----------
    window : Window
        With a gyro.
    knowledge : Knowledge

    Raises
    ------
    Refusal
        If no fit could be had.
    """
    nodes = nodes_of(window, knowledge.mounting.to_body)
    state, priors = start(nodes, priors_of(knowledge, window.bias_sigma))
    fits: dict[str, Fit] = {}
    for name in KINDS:
        _try(fits, name, nodes, priors, state)
    if not fits:
        words = "the samples do not determine a calibration; turn the robot through a full circle"
        raise Refusal(Reason.NO_SOLUTION, words)
    best = min(fits, key=lambda name: fits[name].evidence)
    for name in KINDS:
        # Another kind may have stopped at a worse optimum than the best one's lies at.
        if name != best:
            _try(fits, name, nodes, priors, state, fits[best])
    least = min(each.evidence for each in fits.values())
    odds = {n: math.exp(-BELIEVED * min(f.evidence - least, 700.0)) for n, f in fits.items()}
    weights = {name: value / sum(odds.values()) for name, value in odds.items()}
    best = max(weights, key=lambda name: weights[name])
    to_sensor = knowledge.mounting.matrix
    found = {name: posterior(each, to_sensor) for name, each in fits.items()}
    return Smoothed(nodes, best, fits, weights, mixture(found, weights, best))


def _try(
    fits: dict[str, Fit],
    name: str,
    nodes: Nodes,
    priors: Priors,
    state: State,
    like: Fit | None = None,
) -> None:
    """Fit one kind of motion, and keep the fit if it is the most likely one of its kind."""
    try:
        found = fit(nodes, priors, state, KINDS[name], like=like)
    except np.linalg.LinAlgError:
        return
    known = fits.get(name)
    if np.linalg.det(soft_iron(found.state.shared)) > 0.0 and (
        known is None or found.evidence < known.evidence
    ):
        fits[name] = found


def mixture(found: dict[str, Posterior], weights: dict[str, float], mode: str) -> Posterior:
    """Return the mean of the twelve numbers under all answers, with its covariance."""
    numbers = {name: each.correction.parameters for name, each in found.items()}
    mean = np.sum([weights[name] * each for name, each in numbers.items()], axis=0)
    covariance = np.zeros((12, 12))
    for name, each in found.items():
        off = numbers[name] - mean
        covariance += weights[name] * (each.covariance + np.outer(off, off))
    correction = Correction.from_parameters(mean)
    return replace(found[mode], correction=correction, covariance=covariance)
