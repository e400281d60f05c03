"""Whether one calibration is better than another on road that neither was fitted to."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.keeping.keeping_tuning import KEEPING, KeepingTuning
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoothing.drive_model import turned_into
from magcal_ros.core.smoothing.fit import corrected, favour
from magcal_ros.core.smoothing.nodes import Nodes


@dataclass(frozen=True)
class Proof:
    """What the road after a fit says of a new calibration against an old one.

    Parameters
    ----------
    seconds : float
        Of road.
    turns : int
        Turns that were compared.
    turn_score, turn_gain : float
        Sigmas by which turns are quieter under the new one, and the mean log ratio.
    likelihood : float
        Fall of minus log likelihood on all of the road, independent units.
    halves : tuple of float
        The same of its two halves.
    """

    seconds: float = 0.0
    turns: int = 0
    turn_score: float = 0.0
    turn_gain: float = 0.0
    likelihood: float = 0.0
    halves: tuple[float, float] = (0.0, 0.0)

    def stands(self, tuning: KeepingTuning = KEEPING) -> str:
        """Return in words by what the new one is proved better; empty if it is not."""
        if (
            self.turns >= tuning.fewest_turns
            and self.turn_score > tuning.turn_proof
            and self.turn_gain > tuning.least_gain
        ):
            gain = 100.0 * (1.0 - math.exp(-self.turn_gain))
            return f"{self.turns} turns driven since are {gain:.0f}% quieter"
        if self.likelihood > tuning.likelihood_proof and min(self.halves) > 0.0:
            return (
                f"{self.seconds:.0f} s of road driven since are likelier by"
                f" {self.likelihood:.0f} units, both halves alike"
            )
        return ""


def prove(
    nodes: Nodes,
    old: Correction,
    new: Correction,
    knowledge: Knowledge,
    tuning: KeepingTuning = KEEPING,
) -> Proof:
    """Compare two calibrations on road that neither was fitted to.

    Parameters
    ----------
    nodes : Nodes
        That road.
    old, new : Correction
    knowledge : Knowledge
    tuning : KeepingTuning
    """
    if len(nodes) < 4:
        return Proof()
    seconds = float(nodes.time[-1] - nodes.time[0])
    ratios = turn_ratios(nodes, old, new, knowledge, tuning)
    turns = len(ratios)
    score = gain = 0.0
    if turns:
        gain = float(ratios.mean())
        squares = float(np.sum((ratios - gain) ** 2))
        squares += tuning.pseudo_turns * tuning.turn_spread**2
        spread = math.sqrt(squares / (turns - 1 + tuning.pseudo_turns))
        score = gain / (spread / math.sqrt(turns))
    likelihood, halves = 0.0, (0.0, 0.0)
    if seconds >= tuning.shortest_proof:
        likelihood = favour(nodes, old, new, knowledge)
        middle = len(nodes) // 2
        parts = nodes.take(np.arange(middle)), nodes.take(np.arange(middle, len(nodes)))
        if likelihood > tuning.likelihood_proof:
            first, second = (favour(part, old, new, knowledge) for part in parts)
            halves = first, second
    return Proof(seconds, turns, score, gain, likelihood, halves)


def turn_ratios(
    nodes: Nodes,
    old: Correction,
    new: Correction,
    knowledge: Knowledge,
    tuning: KeepingTuning = KEEPING,
) -> FloatArray:
    """Return for each turn the log of the old field's wander over the new one's, shape (k,).

    Turned back by the gyro a field should stand still.
    """
    back = np.swapaxes(nodes.axes @ turned_into(nodes.heading), 1, 2)
    fields = []
    for each in (old, new):
        inside = corrected(nodes, each, knowledge.mounting.matrix)
        fields.append(np.einsum("nij,nj->ni", back, inside.field)[:, :2])
    found = []
    for first, last in _turns(nodes, tuning):
        wander = [_wander(field[first : last + 1]) for field in fields]
        found.append(math.log(max(wander[0], 1e-6) / max(wander[1], 1e-6)))
    return np.array(found)


def _turns(nodes: Nodes, tuning: KeepingTuning) -> list[tuple[int, int]]:
    """Return first and last node of each turn; they do not overlap."""
    way, heading, found, first = np.cumsum(nodes.metres), nodes.heading, [], 0
    for k in range(1, len(nodes)):
        if not nodes.is_tied[k]:
            first = k
        while way[k] - way[first] > tuning.turn_within:
            first += 1
        span = heading[first : k + 1]
        if k - first >= 2 and np.ptp(span) > tuning.turn:
            found.append((first, k))
            first = k
    return found


def _wander(field: FloatArray) -> float:
    middle = field.mean(axis=0)
    size = float(np.median(np.linalg.norm(field, axis=1)))
    return math.sqrt(float(np.mean(np.sum((field - middle) ** 2, axis=1)))) / max(size, 1e-6)
