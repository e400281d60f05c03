"""What a worker process computes from a drive, and the replay of a recorded drive.

Streams, up, speed and state machine of a replay are those of the node; its jobs are done at once.
It also draws a map of the disturbed field.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.assessment.bounds import SIGMA
from magcal_ros.core.assessment.verdict import LEVEL_ONLY, NO_REFERENCE
from magcal_ros.core.calibration.calibration import Calibration, Evidence
from magcal_ros.core.calibration.correction import PARAMETERS
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import local_sigma
from magcal_ros.core.driving.travel_estimator import TravelReplay
from magcal_ros.core.errors import Refusal
from magcal_ros.core.geometry.arrays import FloatArray, interpolated
from magcal_ros.core.geometry.attitude import level_part, yaw_from_up_and_field
from magcal_ros.core.knowledge import Knowledge, in_level_axes
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import (
    FieldSample,
    ImuSample,
    Pairer,
    PositionSample,
    Streams,
    TravelSample,
)
from magcal_ros.core.samples.window import Window
from magcal_ros.core.self_calibration.jobs import (
    METHOD,
    CandidateKind,
    Decision,
    DriveCandidate,
    DriveJob,
    DriveResult,
    Mode,
    contradicts,
)
from magcal_ros.core.self_calibration.self_calibration import SelfCalibration
from magcal_ros.core.self_calibration.self_calibration_tuning import SELF_CALIBRATION
from magcal_ros.core.smoother import drives
from magcal_ros.core.smoother.iron_added import find_change
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.up.filter import FILTER
from magcal_ros.core.up.follower import propagated_up

MAP_EVERY = 0.5  # seconds between points of the map of a drive


@in_level_axes
def examine_drive(job: DriveJob) -> DriveResult:
    """Return the findings of a job."""
    nodes = drives.drive_nodes(job.log, job.knowledge.mounting.to_body)
    clock = float(job.log.time[-1])
    since_change, since_known = _irons(nodes, job, clock)
    first = max(float(nodes.time[0]) - 5.0, job.changed)
    if since_change is not None:
        first = max(first, since_change.start)
    candidates, refusal = [] if since_known is None else [since_known], ""
    for seconds in job.windows:
        start = clock - seconds
        if start < first:
            continue
        try:
            fitted = drives.fit_drive(job.log, nodes.after(start), job.knowledge)
            candidates.append(candidate_of(fitted, CandidateKind.ALL, job, start, clock))
        except Refusal as why:
            refusal = str(why)
    found, old = tuple(_with_ratio(nodes, each, job) for each in candidates), job.in_force
    ratios = {
        kind: ratio_on(nodes.after(fit.end), old, fit.calibration, job.knowledge)
        for kind, fit in job.contests.items()
        if old is not None
    }
    return DriveResult(clock, found, since_change, ratios, refusal)


def _irons(
    nodes: Nodes, job: DriveJob, clock: float
) -> tuple[DriveCandidate | None, DriveCandidate | None]:
    """Return the hard iron since the most likely change and since the last proved one, if any."""
    old, since_change, since_known = job.in_force, None, None
    if old is None:
        return None, None
    start = max(job.changed, clock - SELF_CALIBRATION.look_back)
    recent = nodes.after(start)
    change = find_change(recent, old, job.knowledge)
    if change is not None and change.gain >= SELF_CALIBRATION.notice:
        found = candidate_of(change.fit, CandidateKind.IRON, job, change.since, clock)
        road = nodes.after(change.since)
        ratio = ratio_on(road, old, found.calibration, job.knowledge)
        since_change = replace(found, ratio=ratio)
    is_changed = math.isfinite(job.changed)
    fitted = drives.fit_iron(recent, old.correction, job.knowledge) if is_changed else None
    if fitted is not None:
        since_known = candidate_of(fitted, CandidateKind.IRON, job, start, clock)
    return since_change, since_known


def _with_ratio(nodes: Nodes, fit: DriveCandidate, job: DriveJob) -> DriveCandidate:
    """Return a fit, with its likelihood ratio if it contradicts the watched calibration."""
    if job.watched is None or not contradicts(fit, job.watched):
        return fit
    road = nodes.after(fit.start)
    return replace(fit, ratio=ratio_on(road, job.watched, fit.calibration, job.knowledge))


def ratio_on(
    road: Nodes, old: Calibration, new: Calibration, knowledge: Knowledge
) -> drives.LikelihoodRatio:
    """Return the log likelihood ratio of a new calibration and an old one; empty if too short."""
    if len(road) < 4:
        return drives.LikelihoodRatio()
    to_sensor = knowledge.mounting.matrix
    before, after = (drives.corrected(road, each.correction, to_sensor) for each in (old, new))
    return drives.likelihood_ratio_of(before, after, knowledge)


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


@dataclass(frozen=True, eq=False)
class DrivePath:
    """The path of a drive, with the disturbance of the field under the last calibration."""

    place: FloatArray  # metres east and north of the beginning. Shape (n, 2).
    error: FloatArray
    """Possible error of the heading by the disturbance, radians: its component across north is
    assumed to be as large as the deviation of level and vertical field. Shape (n,)."""
    is_measured: bool  # whether places are from a receiver; else dead reckoning
    has_speed: bool  # whether a speed was measured; else it is assumed


@dataclass(frozen=True, eq=False)
class DriveReplay:
    """The result of a replay."""

    decisions: tuple[tuple[float, Decision], ...]  # seconds from the beginning, and the decision
    first_calibration: Calibration | None  # in force at the beginning
    last_calibration: Calibration | None  # in force at the end
    seconds: float  # between the first and the last field with a gyro; NaN without one
    moved: float  # seconds of movement
    state: str  # the state at the end, in words
    path: DrivePath | None  # None without a calibration
    course: str = ""  # comparison of compass and course at the end, in words; or empty
    fault: str = ""  # possible fault of the sensors, if no calibration was found


def replay_drive(
    knowledge: Knowledge,
    calibration: Calibration | None,
    readings: Iterable[ImuSample | FieldSample | None],
    travel: Iterable[TravelSample],
    machine: SelfCalibration | None = None,
) -> DriveReplay:
    """Run self-calibration on a recording.

    Readings are in order of arrival, travel in order of stamps; `calibration` is in force at the
    beginning.
    """
    streams, ways = Streams(STREAMS.max_gap), list(travel)
    replay, now, pairer = TravelReplay(ways, streams), calibration, Pairer(streams)
    machine = SelfCalibration(Mode.APPLY) if machine is None else machine
    machine.put_in_force(calibration)
    decisions: list[tuple[float, Decision]] = []
    points: list[tuple[float, ...]] = []  # stamp, speed, raw field and up
    first, last, due = math.nan, math.nan, -math.inf
    for sample in replay.readings(readings):
        imu = streams.newest_imu
        if not isinstance(sample, FieldSample) or imu is None or not math.isfinite(imu.rate[0]):
            continue
        last = sample.stamp
        first = last if math.isnan(first) else first
        speed, up = replay.estimator.speed_near(last), replay.up.newest
        if up is not None and not last < due:
            points.append((last, speed, *sample.field, *up))
            due = last + MAP_EVERY
        if not streams.is_repeated:
            pairer.offer(sample)
        for pair in pairer.take():
            if not machine.add(pair, speed):
                continue
            for decision in machine.note(examine_drive(machine.job(knowledge))):
                decisions.append((last - first, decision))
                if decision.is_change:
                    now = decision.calibration
                    machine.put_in_force(now)
    path = None
    if now is not None and len(points) > 1:
        rows = np.array(points)
        fixes = np.array([each[:3] for each in ways if isinstance(each, PositionSample)])
        measured = fixes if len(fixes) > 2 else None
        path = path_along(now, rows[:, 0], rows[:, 2:5], rows[:, 5:], rows[:, 1], measured)
    seconds, moved = last - first, machine.recorder.moved
    return DriveReplay(tuple(decisions), calibration, now, seconds, moved, machine.in_words, path)


def path_along(
    calibration: Calibration,
    time: FloatArray,
    raw: FloatArray,
    up: FloatArray,
    speed: FloatArray,
    fixes: FloatArray | None = None,
) -> DrivePath:
    """Return the path of a drive with the disturbance of the field.

    Raw field (tesla) and up are (n, 3) in body axes, `time` (n,) in seconds, `speed` (n,) in m/s,
    NaN if unknown. `fixes` (k, 3) are stamps, metres east and north; without them places are
    dead-reckoned.
    """
    field = calibration.correction.apply(raw)
    rise = np.sum(field * up, axis=1)
    level = np.linalg.norm(level_part(field, up), axis=1)
    dip = calibration.inclination
    disturbance = np.hypot(
        level - calibration.strength * math.cos(dip), rise + calibration.strength * math.sin(dip)
    )
    error = np.arctan2(disturbance, calibration.strength * math.cos(dip))
    known = np.isfinite(speed)
    if fixes is not None:
        place = interpolated(time, fixes[:, 0], fixes[:, 1:])
    else:
        yaw = yaw_from_up_and_field(up, field)
        steps = np.diff(time, prepend=time[0]).clip(0.0, 2.0 * MAP_EVERY)
        steps *= np.where(known, speed, FILTER.usual_speed)
        place = np.cumsum(steps[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)]), axis=0)
    return DrivePath(place - place[0], error, fixes is not None, bool(known.any()))


def path_of_log(log: Window, calibration: Calibration) -> DrivePath | None:
    """Return the path of the record of a drive; None if it is too short."""
    if len(log) < 10:
        return None
    every = max(1, round(MAP_EVERY / float(np.median(np.diff(log.time)))))
    up, speed = propagated_up(log), np.full(len(log), math.nan) if log.speed is None else log.speed
    rows = (values[::every] for values in (log.time, log.field, up, speed))
    return path_along(calibration, *rows)
