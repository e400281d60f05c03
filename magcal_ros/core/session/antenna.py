"""Calibrating by headings that another device measured, live or in a recording."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from magcal_ros.core.assessment.verdict import judge
from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, wrapped
from magcal_ros.core.geometry.vec3 import Triple, dot
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.known_headings import declination_hint, fit
from magcal_ros.core.samples.streams import (
    STREAMS,
    FieldSample,
    HeadingSample,
    ImuSample,
    Pair,
    Pairer,
    Streams,
)
from magcal_ros.core.session.at_known_heading import CollectedSamples, calibrate_standing
from magcal_ros.core.session.external_heading import LOG, ExternalHeading, HeadingAgainstGyro
from magcal_ros.core.session.recorded import Reading
from magcal_ros.core.smoother.standings import Standing
from magcal_ros.core.smoother.unknowns import SIZES
from magcal_ros.core.up import UpFollower


class HeadingLog:
    """Keeps means of the field at known headings, a few of each direction.

    Parameters
    ----------
    forward : ndarray, shape (3,)
        Direction in the IMU's axes whose heading is given.
    """

    def __init__(self, forward: FloatArray) -> None:
        self.forward = forward
        self._kept: list[deque[tuple[float, Standing]]] = [
            deque(maxlen=LOG.each) for _ in range(LOG.sectors)
        ]
        self._newest, self._fresh = -math.inf, 0
        self._rested = False
        self._begin(math.nan)

    def _begin(self, stamp: float) -> None:
        self._started, self._count = stamp, 0
        self._field, self._up = np.zeros(3), np.zeros(3)
        self._east = self._north = 0.0

    def add(
        self,
        stamp: float,
        field: Triple,
        up: Triple,
        rate: Triple,
        given: ExternalHeading,
        shift: float,
        is_at_rest: bool,
    ) -> bool:
        """Take a field sample; returns whether enough is new for a fit.

        Parameters
        ----------
        stamp : float
            Seconds.
        field : tuple of float
            Raw, tesla.
        up, rate : tuple of float
            Unit, and rad/s less the bias, body axes.
        given : ExternalHeading
            Of this moment.
        shift : float
            Declination, if the heading is to true north, radians.
        is_at_rest : bool
            Whether the robot stands: one mean tells all that is to be had there.
        """
        self._rested = self._rested and is_at_rest
        if self._rested:
            return False
        if abs(dot(rate, up)) > LOG.rate:
            self._begin(math.nan)
            return False
        if not 0.0 <= stamp - self._started < 2.0 * LOG.block:
            self._begin(stamp)
        self._field += field
        self._up += up
        self._east += math.cos(given.yaw)
        self._north += math.sin(given.yaw)
        self._count += 1
        if stamp - self._started < LOG.block or self._count < LOG.fewest:
            return False
        heading = wrapped(math.atan2(self._north, self._east) + shift)
        standing = Standing(
            self._field / self._count,
            STANDARD_GRAVITY * self._up / self._count,
            heading,
            math.hypot(given.sigma, LOG.sigma),
            by_declination=given.is_true,
            forward=self.forward,
            force_sigma=LOG.force,
        )
        self._begin(math.nan)
        self._rested = is_at_rest
        return self._keep(stamp, heading, standing)

    def _keep(self, stamp: float, heading: float, standing: Standing) -> bool:
        sector = self._kept[int((heading % math.tau) / math.tau * LOG.sectors) % LOG.sectors]
        since = stamp - (sector[-1][0] if sector else self._newest)
        if 0.0 <= since < (LOG.pause if sector else LOG.block):
            return False
        sector.append((stamp, standing))
        self._newest = stamp
        self._fresh += 1
        return self._fresh >= max(LOG.first, len(self.standings) // 3)

    @property
    def standings(self) -> tuple[Standing, ...]:
        """What is kept, in the order of time."""
        found = [each for sector in self._kept for each in sector]
        return tuple(standing for _, standing in sorted(found, key=lambda each: each[0]))

    def take(self) -> tuple[Standing, ...]:
        """Return what is kept, for a fit; what comes after is new."""
        self._fresh = 0
        return self.standings


def fit_log(standings: tuple[Standing, ...], knowledge: Knowledge) -> tuple[Outcome, str]:
    """Calibrate from headings that were measured on the way, and judge the result.

    The words say whether they seem to be to the other north; empty where nothing points to it.
    """
    try:
        estimate = fit(standings, knowledge, SIZES["street"])
    except Refusal as refusal:
        return Outcome.refused(refusal), ""
    verdict = judge(estimate, knowledge)
    calibration = Calibration.from_estimate(estimate, verdict.evidence(estimate))
    hint = declination_hint(estimate, standings, knowledge)
    return Outcome(verdict, calibration, estimate), hint


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
