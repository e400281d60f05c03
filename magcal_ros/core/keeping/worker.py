"""What a worker computes for self-calibration: fits and proofs of one look."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.errors import Refusal
from magcal_ros.core.keeping.candidates import DriveCandidate, Kind, candidate_of
from magcal_ros.core.keeping.jobs import DriveJob, Findings
from magcal_ros.core.keeping.keeping_tuning import KEEPING
from magcal_ros.core.keeping.proving import prove
from magcal_ros.core.smoothing.change import find_change
from magcal_ros.core.smoothing.fit import fit_iron, fit_nodes
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
