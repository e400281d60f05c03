"""A calibration from recordings at known headings, without a turn."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.vec3 import dot
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.streams import (
    STREAMS,
    FieldSample,
    HeadingSample,
    ImuSample,
    Pair,
    Pairer,
    Streams,
)
from magcal_ros.core.session.antenna import HeadingLog, fit_log
from magcal_ros.core.session.at_known_heading import CollectedSamples, calibrate_standing
from magcal_ros.core.session.external_heading import LOG, ExternalHeading, HeadingAgainstGyro
from magcal_ros.core.session.recorded import Reading
from magcal_ros.core.smoother.standings import Standing
from magcal_ros.core.up import UpFollower

FORWARD = np.array([1.0, 0.0, 0.0])
"""The heading is that of the IMU's x axis."""


def standing_pairs(readings: Iterable[Reading]) -> tuple[Pair, ...]:
    """Return the field samples of a recording, each with the IMU's of its moment."""
    streams = Streams(STREAMS.max_gap)
    pairer, found = Pairer(streams), list[Pair]()
    for reading in readings:
        if isinstance(reading, ImuSample):
            streams.add_imu(reading)
        elif isinstance(reading, FieldSample) and streams.add_field(reading):
            pairer.offer(reading)
        found += pairer.take()
    return tuple(found)


def fit_at_headings(
    recordings: Sequence[tuple[Pair, ...]], given: Sequence[ExternalHeading], knowledge: Knowledge
) -> tuple[Outcome, str]:
    """Calibrate from recordings of a robot that stands; returns the outcome, and its words."""
    standings: tuple[Standing, ...] = ()
    outcome, words = Outcome.refused(Refusal(Reason.TOO_FEW_SAMPLES, "no heading was given")), ""
    for pairs, heading in zip(recordings, given, strict=True):
        result = calibrate_standing(standings, CollectedSamples(pairs, heading, knowledge, FORWARD))
        standings, outcome, words = result.standings, result.outcome, result.words
        if outcome.calibration is None:
            break
    return outcome, words


def fit_heading_topic(
    readings: Iterable[Reading],
    headings: Sequence[HeadingSample],
    is_true: bool,
    knowledge: Knowledge,
) -> Outcome:
    """Calibrate from a recording in which somebody else measures the heading."""
    declination = knowledge.reference.declination
    if is_true and declination is None:
        words = "the headings are to true north, and the declination is not known: give the place"
        return Outcome.refused(Refusal(Reason.NO_SOLUTION, words))
    shift = (declination or 0.0) if is_true else 0.0
    log, up, against = HeadingLog(FORWARD), UpFollower(), HeadingAgainstGyro()
    waiting, newest, stamp = iter(headings), HeadingSample(-math.inf, 0.0, 1.0), math.nan
    following = next(waiting, None)
    for reading in readings:
        if isinstance(reading, ImuSample):
            up.add(reading)
            seconds, stamp = reading.stamp - stamp, reading.stamp
            if up.newest is not None and 0.0 < seconds <= STREAMS.longest_gyro_step:
                against.add_turn(dot(up.mean_rate, up.newest) * seconds)
        elif isinstance(reading, FieldSample):
            up.add_field(reading.stamp, reading.field)
            while following is not None and following.stamp <= reading.stamp:
                newest, following = following, next(waiting, None)
                against.add(newest.stamp, newest.yaw)
            above = up.at(reading.stamp, STREAMS.max_gap)
            if above is None or reading.stamp - newest.stamp > LOG.block or not up.is_propagated:
                continue
            external = ExternalHeading(newest.yaw, newest.sigma, is_true)
            seen = reading.stamp, reading.field, above.direction, up.rate
            log.add(*seen, external, shift, up.is_at_rest)
        if against.fault:
            return Outcome.refused(Refusal(Reason.HEADING_CONTRADICTED, against.fault))
    if not log.standings:
        words = "no field sample came within half a second of a heading, with a gyro"
        return Outcome.refused(Refusal(Reason.TOO_FEW_SAMPLES, words))
    outcome, north = fit_log(log.standings, knowledge)
    if not north:
        return outcome
    words = f"{outcome.verdict.summary} But {north}."
    return replace(outcome, verdict=replace(outcome.verdict, summary=words))
