"""Whether one calibration is better than another on road that neither was fitted to."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.keeping.keeping_tuning import KEEPING, KeepingTuning
from magcal_ros.core.keeping.proofs import Proof
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoothing.drive_model import turned_into
from magcal_ros.core.smoothing.fit import corrected, favour
from magcal_ros.core.smoothing.nodes import Nodes


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
