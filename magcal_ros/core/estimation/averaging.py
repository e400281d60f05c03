"""From a window to the fit's own samples: scaled, and no more of them than carry information."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.estimation.model import Samples
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.knowledge import Knowledge

TYPICAL_STRENGTH = 50e-6
"""Tesla of one field scale where the strength is unknown."""


@dataclass(frozen=True)
class SpikeTuning:
    """When a sample is left out of an average.

    Parameters
    ----------
    sigmas : float
        Robust ones, from its neighbours' median.
    neighbours : int
        Of which the median is taken, itself among them; odd.
    """

    sigmas: float = 4.5
    neighbours: int = 9


SPIKES = SpikeTuning()


@dataclass(frozen=True, eq=False)
class Prepared:
    """Samples for the fit.

    Parameters
    ----------
    all : Samples
        One for each row of the window.
    averaged : Samples
        Neighbours averaged where there are very many; otherwise the same.
    first : ndarray of int
        Where in `all` each averaged sample begins.
    scale : float
        Tesla of one field scale.
    """

    all: Samples
    averaged: Samples
    first: IntArray
    scale: float

    @property
    def width(self) -> float:
        """How many samples of `all` make one averaged sample."""
        return len(self.all) / len(self.averaged)


def field_scale(knowledge: Knowledge) -> float:
    """Return tesla of one field scale: the strength where one is known."""
    strength = knowledge.reference.strength
    return TYPICAL_STRENGTH if strength.is_unknown else abs(strength.value) or TYPICAL_STRENGTH


def prepare(field: FloatArray, force: FloatArray, knowledge: Knowledge, largest: int) -> Prepared:
    """Scale the samples, and average neighbours where there are more than `largest`.

    An average over a short stretch keeps all information: the noise falls as if each sample had
    been fitted, and the radius shrinks by a millionth at 1000 samples a turn.

    Parameters
    ----------
    field : ndarray, shape (n, 3)
        Raw field, tesla.
    force : ndarray, shape (n, 3)
        Specific force or up, body axes, any length.
    knowledge : Knowledge
    largest : int
        Bound on the number of averaged samples.
    """
    scale = field_scale(knowledge)
    samples = Samples(unit(force), field / scale, knowledge.mounting.matrix)
    n = len(samples)
    width = math.ceil(n / largest)
    first = np.arange(0, n, width)
    if width == 1:
        return Prepared(samples, samples, first, scale)
    good = without_spikes(samples.field) & without_spikes(samples.up)
    averaged = Samples(
        unit(_averages(samples.up, good, first)),
        _averages(samples.field, good, first),
        samples.mounting,
    )
    return Prepared(samples, averaged, first, scale)


def without_spikes(values: FloatArray) -> BoolArray:
    """Return which rows (n, 3) agree with the median of their neighbours (a Hampel filter)."""
    reach = SPIKES.neighbours // 2
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    stretches = np.lib.stride_tricks.sliding_window_view(padded, SPIKES.neighbours, axis=0)
    away = np.abs(values - np.median(stretches, axis=2))
    usual = 1.4826 * np.median(away, axis=0) + 1e-12
    return np.asarray((away < SPIKES.sigmas * usual).all(axis=1))


def _averages(values: FloatArray, good: BoolArray, first: IntArray) -> FloatArray:
    """Average the good rows of each stretch; all of its rows where none is good."""
    weight = good.astype(float)
    empty = np.add.reduceat(weight, first) == 0.0
    stretch = np.repeat(np.arange(len(first)), np.diff(np.append(first, len(values))))
    weight[empty[stretch]] = 1.0
    total = np.add.reduceat(values * weight[:, None], first, axis=0)
    return np.asarray(total / np.add.reduceat(weight, first)[:, None])


def thinned(samples: Samples, largest: int) -> Samples:
    """Return every k-th sample so that at most `largest` remain."""
    return samples.take(slice(None, None, math.ceil(len(samples) / largest)))
