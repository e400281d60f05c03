"""The fits and comparisons that a worker process computes for self-calibration."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_ros.core.errors import Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import rotation_about
from magcal_ros.core.keeping.candidates import (
    KEEPING,
    DriveCandidate,
    KeepingTuning,
    Kind,
    candidate_of,
)
from magcal_ros.core.keeping.jobs import Contest, DriveJob, Findings, Proof, Step
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoother.drives import (
    LikelihoodRatio,
    corrected,
    drive_nodes,
    fit_drive,
    fit_iron,
    likelihood_ratio_of,
)
from magcal_ros.core.smoother.iron_added import find_change
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.start import held_by_gyro


def answer(job: DriveJob) -> Findings:
    """Do a job."""
    nodes = drive_nodes(job.log, job.knowledge.mounting.to_body)
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
    change = find_change(nodes.between(first), job.in_force, job.knowledge)
    if change is None or change.gain < KEEPING.notice_proof:
        return None
    return candidate_of(change.fit, Kind.IRON, job.in_force, change.since, clock)


def _iron_since(nodes: Nodes, job: DriveJob, start: float, clock: float) -> DriveCandidate | None:
    if clock - start < KEEPING.shortest_since:
        return None
    start = max(start, clock - KEEPING.longest_since)
    return _iron(nodes.between(start), job, start, clock)


def _newest(nodes: Nodes, clock: float, seconds: float, not_before: float) -> Nodes | None:
    """Return the last seconds of road; None where there are not so many."""
    start = clock - seconds
    if start < max(not_before, float(nodes.time[0]) - 5.0):
        return None
    return nodes.between(start)


def _all_twelve(nodes: Nodes, job: DriveJob, start: float, end: float) -> DriveCandidate | None:
    try:
        fitted = fit_drive(job.log, nodes, job.knowledge)
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
    road = nodes.between(contest.new[0].since)
    if len(road) < 4:
        return Proof()
    seconds = float(np.ptp(road.time))
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
    ratio = LikelihoodRatio()
    if seconds >= tuning.shortest_proof:
        ratio = likelihood_ratio_of(before, after, knowledge)
    likelihood = ratio.gain, ratio.halves, ratio.elsewhere, ratio.against
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
    _, level, yaw = held_by_gyro(old)
    back = level @ rotation_about(np.array([0.0, 0.0, 1.0]), -yaw)
    fields = [np.einsum("nji,nj->ni", back, each.field)[:, :2] for each in (old, new)]
    found = []
    for first, last in _turns(old, yaw, tuning):
        wander = [_wander(field[first : last + 1]) for field in fields]
        found.append(math.log(max(wander[0], 1e-6) / max(wander[1], 1e-6)))
    return np.array(found)


def _turns(nodes: Nodes, yaw: FloatArray, tuning: KeepingTuning) -> list[tuple[int, int]]:
    """Return first and last node of each turn; they do not overlap."""
    speed = tuning.usual_speed if nodes.speed is None else np.nan_to_num(np.abs(nodes.speed[:-1]))
    way = np.append(0.0, np.cumsum(nodes.seconds * speed))
    found, first = [], 0
    for k in range(1, len(nodes)):
        if not nodes.is_tied[k - 1]:
            first = k
        while way[k] - way[first] > tuning.turn_within:
            first += 1
        span = yaw[first : k + 1]
        if k - first >= 2 and np.ptp(span) > tuning.turn:
            found.append((first, k))
            first = k
    return found


def _wander(field: FloatArray) -> float:
    middle = field.mean(axis=0)
    size = float(np.median(np.linalg.norm(field, axis=1)))
    return math.sqrt(float(np.mean(np.sum((field - middle) ** 2, axis=1)))) / max(size, 1e-6)
