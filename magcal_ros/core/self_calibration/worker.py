"""The fits and comparisons that a worker process computes for self-calibration."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_ros.core.assessment.bounds import SIGMA
from magcal_ros.core.assessment.verdict import LEVEL_ONLY, NO_REFERENCE
from magcal_ros.core.calibration.calibration import Calibration, Evidence
from magcal_ros.core.calibration.correction import PARAMETERS, Correction
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import local_sigma
from magcal_ros.core.errors import Refusal
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.self_calibration.jobs import (
    METHOD,
    SELF_CALIBRATION,
    CandidateKind,
    DriveCandidate,
    DriveJob,
    DriveResult,
)
from magcal_ros.core.self_calibration.watch import contradicts
from magcal_ros.core.smoother import drives
from magcal_ros.core.smoother.iron_added import find_change
from magcal_ros.core.smoother.nodes import Nodes


def examine_drive(job: DriveJob) -> DriveResult:
    """Return the findings of a job."""
    nodes = drives.drive_nodes(job.log, job.knowledge.mounting.to_body)
    clock = float(job.log.time[-1])
    since_change = _since_change(nodes, job, clock)
    first = max(float(nodes.time[0]) - 5.0, job.changed)
    if since_change is not None:
        first = max(first, since_change.start)
    iron, refusal = _iron_since_known(nodes, job, clock), ""
    candidates = [] if iron is None else [iron]
    for seconds in job.windows:
        if clock - seconds < first:
            continue
        try:
            candidates.append(_all_twelve(nodes, job, clock - seconds, clock))
        except Refusal as why:
            refusal = str(why)
    ratios = {
        kind: ratio_on_later_data(nodes, job.in_force.correction, fits, job.knowledge)
        for kind, fits in job.contests.items()
        if job.in_force is not None
    }
    if since_change is not None:
        since_change = _with_ratio(nodes, since_change, job)
    found = tuple(_with_ratio(nodes, each, job) for each in candidates)
    return DriveResult(clock, found, since_change, ratios, refusal)


def _since_change(nodes: Nodes, job: DriveJob, clock: float) -> DriveCandidate | None:
    """Return the hard iron since the most likely change; None if no change is likely."""
    if job.in_force is None:
        return None
    first = max(clock - SELF_CALIBRATION.look_back, job.changed)
    change = find_change(nodes.between(first), job.in_force, job.knowledge)
    if change is None or change.gain < SELF_CALIBRATION.notice_proof:
        return None
    return candidate_of(change.fit, CandidateKind.IRON, job, change.since, clock)


def _iron_since_known(nodes: Nodes, job: DriveJob, clock: float) -> DriveCandidate | None:
    """Return the hard iron since the last proved change; None without one."""
    is_long = SELF_CALIBRATION.shortest_since <= clock - job.changed < math.inf
    if job.in_force is None or not is_long:
        return None
    start = max(job.changed, clock - SELF_CALIBRATION.look_back)
    fitted = drives.fit_iron(nodes.between(start), job.in_force.correction, job.knowledge)
    return None if fitted is None else candidate_of(fitted, CandidateKind.IRON, job, start, clock)


def _all_twelve(nodes: Nodes, job: DriveJob, start: float, end: float) -> DriveCandidate:
    fitted = drives.fit_drive(job.log, nodes.between(start), job.knowledge)
    return candidate_of(fitted, CandidateKind.ALL, job, start, end)


def _with_ratio(nodes: Nodes, fit: DriveCandidate, job: DriveJob) -> DriveCandidate:
    """Return a fit, with its likelihood ratio if it contradicts the watched calibration."""
    if job.watched is None or not contradicts(fit, job.watched):
        return fit
    both = job.watched, fit.calibration
    road, to_body = nodes.between(fit.start), job.knowledge.mounting.matrix
    old, new = (drives.corrected(road, each.correction, to_body) for each in both)
    return replace(fit, ratio=drives.likelihood_ratio_of(old, new, job.knowledge))


def ratio_on_later_data(
    nodes: Nodes, old: Correction, new: tuple[DriveCandidate, ...], knowledge: Knowledge
) -> drives.LikelihoodRatio:
    """Return the log likelihood ratio of a new calibration and an old one on held-out data.

    If the new calibration is refitted, each stretch is predicted by the fit before it (prequential;
    Dawid, 1984), so that all data since the first fit count.
    """
    road = nodes.between(new[0].end)
    if len(road) < 4:
        return drives.LikelihoodRatio()
    before = drives.corrected(road, old, knowledge.mounting.matrix)
    return drives.likelihood_ratio_of(before, _read(road, new, knowledge), knowledge)


def _read(nodes: Nodes, fits: tuple[DriveCandidate, ...], knowledge: Knowledge) -> Nodes:
    """Return the nodes, each corrected by the newest fit before it."""
    field = nodes.field.copy()
    for fit in fits:
        later = nodes.time > fit.end
        read = drives.corrected(nodes, fit.calibration.correction, knowledge.mounting.matrix)
        field[later] = read.field[later]
    return replace(nodes, field=field)


def candidate_of(
    fitted: drives.DriveFit, kind: CandidateKind, job: DriveJob, start: float, end: float
) -> DriveCandidate:
    """Return the candidate from a fit to the drive between two stamps."""
    posterior, before, reference = fitted.posterior, job.in_force, job.knowledge.reference
    sigma, covariance = posterior.heading_sigma, posterior.covariance
    if kind is CandidateKind.IRON and before is not None:
        # The matrix and its covariance are those of the old calibration.
        covariance = np.zeros_like(covariance)
        covariance[:9, :9] = before.covariance[:9, :9]
        covariance[9:, 9:] = posterior.covariance[9:, 9:]
    words = (
        f"Calibrated from {fitted.seconds:.0f} s of ordinary driving, {fitted.sectors} of 12"
        f" headings: heading ±{math.degrees(sigma):.1f}° on level ground (1σ) by the calibration"
    )
    figures = {
        Figure.HEADINGS_DRIVEN.value: float(fitted.sectors),
        Figure.DRIVING_TIME.value: fitted.seconds,
        Figure.STREET.value: fitted.street,
        Figure.LOCAL_FIELD.value: fitted.local_field,
    }
    # The raw field of the drive contains the motors' field.
    motors = None if before is None else before.motors
    motors = None if motors is None else motors.with_another_calibration()
    calibration = Calibration(
        posterior.correction,
        covariance,
        fitted.noise,
        0.01 if before is None else before.noise_up,
        posterior.strength,
        posterior.inclination,
        Evidence(
            METHOD,
            "good",
            SIGMA.check(sigma).grade.value,
            words,
            not_shown=() if reference.is_complete else (NO_REFERENCE, LEVEL_ONLY),
            figures=figures,
        ),
        motors,
    )
    # Two more figures follow from the calibration.
    by_place = local_sigma(calibration)
    figures[Figure.LOCAL_SIGMA.value] = by_place
    figures[Figure.HEADING_SIGMA.value] = math.hypot(sigma, by_place)
    evidence = calibration.evidence.made_with(reference)
    calibration = replace(calibration, evidence=evidence)
    found, by_motion = posterior.correction, posterior.numbers[PARAMETERS : PARAMETERS + 3]
    in_motion = replace(found, hard_iron=found.hard_iron + by_motion)
    return DriveCandidate(kind, calibration, start, end, in_motion)
