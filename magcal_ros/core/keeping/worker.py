"""What a worker computes for self-calibration: fits and proofs of one look."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.errors import Refusal
from magcal_ros.core.keeping.candidates import DriveCandidate, Kind, candidate_of, is_another
from magcal_ros.core.keeping.jobs import DriveJob, Findings
from magcal_ros.core.keeping.keeping_tuning import KEEPING
from magcal_ros.core.keeping.proving import prove
from magcal_ros.core.smoothing.fit import fit_iron, fit_nodes, onset
from magcal_ros.core.smoothing.nodes import Nodes


def answer(job: DriveJob) -> Findings:
    """Do a job."""
    nodes = job.log.nodes(job.knowledge.mounting.to_body)
    clock = float(job.log.time[-1])
    found: list[DriveCandidate | None] = []
    for seconds in job.iron_windows:
        part = _newest(nodes, clock, seconds, job.not_before)
        if part is not None:
            found.append(_iron(part, job, clock - seconds, clock))
    irons = [each for each in found if each is not None]
    since_change = _since_change(nodes, job, irons, clock)
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


def _since_change(
    nodes: Nodes, job: DriveJob, irons: list[DriveCandidate], clock: float
) -> DriveCandidate | None:
    """Return the hard iron of all road since a change, where one is suspected."""
    if job.in_force is None:
        return None
    suspect, old, tuning = job.suspect, job.in_force, KEEPING
    if suspect is None:
        others = [each for each in irons if is_another(each, old)]
        if not others:
            return None
        suspect = min(others, key=lambda each: each.sigma).calibration.correction
    first = max(clock - tuning.look_back, job.not_before)
    recent = nodes.take(np.flatnonzero(nodes.time >= first))
    found = None
    for _ in range(2):
        start = onset(recent, old.correction, suspect, job.knowledge)
        found = _iron_since(recent, job, start, clock)
        if found is None:
            return None
        suspect = found.calibration.correction
    return found


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
