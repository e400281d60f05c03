"""Whether one calibration is better than another on road that neither was fitted to."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.keeping.jobs import Contest, Step
from magcal_ros.core.keeping.keeping_tuning import KEEPING, KeepingTuning
from magcal_ros.core.keeping.proofs import Proof
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoothing.drive_model import turned_into
from magcal_ros.core.smoothing.fit import LikelihoodRatio, corrected, likelihood_ratio_of
from magcal_ros.core.smoothing.nodes import Nodes


def prove(
    nodes: Nodes, contest: Contest, knowledge: Knowledge, tuning: KeepingTuning = KEEPING
) -> Proof:
    """Compare two calibrations on road that neither was fitted to.

    Of a new one that is fitted anew now and then each stretch is foretold by the fit before it
    (prequential; Dawid, 1984), so that all road since the first fit counts.

    Parameters
    ----------
    nodes : Nodes
        That road, and more.
    contest : Contest
    knowledge : Knowledge
    tuning : KeepingTuning
    """
    rows = np.flatnonzero(nodes.time > contest.new[0].since)
    if len(rows) < 4:
        return Proof()
    road = nodes.take(rows)
    seconds = float(road.time[-1] - road.time[0])
    before = _read(road, (Step(-math.inf, contest.old),), knowledge)
    after = _read(road, contest.new, knowledge)
    ratios = turn_ratios(before, after, tuning)
    turns = len(ratios)
    score = gain = 0.0
    if turns:
        gain = float(ratios.mean())
        squares = float(np.sum((ratios - gain) ** 2))
        squares += tuning.pseudo_turns * tuning.turn_spread**2
        spread = math.sqrt(squares / (turns - 1 + tuning.pseudo_turns))
        score = gain / (spread / math.sqrt(turns))
    ratio, halves = LikelihoodRatio(), (0.0, 0.0)
    if seconds >= tuning.shortest_proof:
        ratio = likelihood_ratio_of(before, after, knowledge)
        if ratio.gain > min(tuning.iron_proof, tuning.likelihood_proof):
            middle = len(road) // 2
            parts = np.arange(middle), np.arange(middle, len(road))
            first, second = (
                likelihood_ratio_of(before.take(part), after.take(part), knowledge).gain
                for part in parts
            )
            halves = first, second
    likelihood = ratio.gain, halves, ratio.elsewhere, ratio.against
    return Proof(seconds, turns, score, gain, *likelihood)


def _read(nodes: Nodes, steps: tuple[Step, ...], knowledge: Knowledge) -> Nodes:
    """Return the nodes, each corrected by the step of its time."""
    field = nodes.field.copy()
    for since, correction in steps:
        later = nodes.time > since
        field[later] = corrected(nodes, correction, knowledge.mounting.matrix).field[later]
    return replace(nodes, field=field)


def turn_ratios(old: Nodes, new: Nodes, tuning: KeepingTuning = KEEPING) -> FloatArray:
    """Return for each turn the log of the old field's wander over the new one's, shape (k,).

    Both are the same corrected nodes. Turned back by the gyro a field should stand still.
    """
    back = np.swapaxes(old.axes @ turned_into(old.heading), 1, 2)
    fields = [np.einsum("nij,nj->ni", back, each.field)[:, :2] for each in (old, new)]
    found = []
    for first, last in _turns(old, tuning):
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
