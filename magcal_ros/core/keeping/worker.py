"""The fits and comparisons that a worker process computes for self-calibration."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_ros.core.errors import Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.keeping.candidates import (
    KEEPING,
    DriveCandidate,
    KeepingTuning,
    Kind,
    candidate_of,
)
from magcal_ros.core.keeping.jobs import Contest, DriveJob, Findings, Proof, Step
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoothing.change import find_change
from magcal_ros.core.smoothing.drive_model import turned_into
from magcal_ros.core.smoothing.fit import (
    LikelihoodRatio,
    corrected,
    fit_iron,
    fit_nodes,
    likelihood_ratio_of,
)
from magcal_ros.core.smoothing.nodes import Nodes


def answer(job: DriveJob) -> Findings:
    """Do a job."""
    nodes = job.log.nodes(job.knowledge.mounting.to_body)
    clock = float(job.log.time[-1])
    found: list[DriveCandidate | None] = []
    since_change = _since_change(nodes, job, clock)
    finer = None
    if math.isfinite(job.changed):
        finer = _iron_since(nodes, job, job.changed, clock)
    not_before = job.not_before
    if since_change is not None:
        not_before = max(not_before, since_change.start)
    for seconds in job.windows:
        part = _newest(nodes, clock, seconds, not_before)
        if part is not None:
            found.append(_all_twelve(part, job, clock - seconds, clock))
    proofs = {contest.name: prove(nodes, contest, job.knowledge) for contest in job.contests}
    whole = tuple(each for each in found if each is not None)
    return Findings(clock, whole, since_change, finer, proofs)


def _since_change(nodes: Nodes, job: DriveJob, clock: float) -> DriveCandidate | None:
    """Return the hard iron of all road since a change, where the road is likelier with one."""
    if job.in_force is None:
        return None
    first = max(clock - KEEPING.look_back, job.not_before)
    rows = np.flatnonzero(nodes.time >= first)
    if not len(rows):
        return None
    change = find_change(nodes.take(rows), job.in_force, job.knowledge)
    if change is None or change.gain < KEEPING.notice_proof:
        return None
    return candidate_of(change.fit, Kind.IRON, job.in_force, change.since, clock)


def _iron_since(nodes: Nodes, job: DriveJob, start: float, clock: float) -> DriveCandidate | None:
    if clock - start < KEEPING.shortest_since:
        return None
    start = max(start, clock - KEEPING.longest_since)
    rows = np.flatnonzero(nodes.time >= start)
    return _iron(nodes.take(rows), job, start, clock) if len(rows) else None


def _newest(nodes: Nodes, clock: float, seconds: float, not_before: float) -> Nodes | None:
    """Return the last seconds of road; None where there are not so many."""
    start = clock - seconds
    if start < max(not_before, float(nodes.time[0]) - 5.0):
        return None
    rows = np.flatnonzero(nodes.time >= start)
    return nodes.take(rows) if len(rows) else None


def _all_twelve(nodes: Nodes, job: DriveJob, start: float, end: float) -> DriveCandidate | None:
    try:
        fitted = fit_nodes(nodes, job.knowledge)
    except Refusal:
        return None
    return candidate_of(fitted, Kind.ALL, job.in_force, start, end)


def _iron(nodes: Nodes, job: DriveJob, start: float, end: float) -> DriveCandidate | None:
    if job.in_force is None:
        return None
    fitted = fit_iron(nodes, job.in_force.correction, job.knowledge)
    if fitted is None:
        return None
    return candidate_of(fitted, Kind.IRON, job.in_force, start, end)


def prove(
    nodes: Nodes, contest: Contest, knowledge: Knowledge, tuning: KeepingTuning = KEEPING
) -> Proof:
    """Compare two calibrations on road that neither was fitted to.

    Of a new one that is fitted anew now and then each stretch is predicted by the fit before it
    (prequential; Dawid, 1984), so that all road since the first fit counts.
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
