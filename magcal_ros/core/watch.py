"""Whether a calibration still holds while the robot drives, from message to message.

Each visit to a heading leaves one record, and a robot that stands leaves no more of them, so that
neither a long pause beside a car nor a long straight way weighs. Only what many headings say
together, and say for a while, is called a change.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.attitude import wrapped
from magcal_ros.core.calibration import Calibration
from magcal_ros.core.holds import STEEPEST_NOSE, Finding, State
from magcal_ros.core.streams import LONGEST_CARRY
from magcal_ros.core.triples import Triple, dot, length
from magcal_ros.core.watch_fit import Measured, Record, measure, onset

MEMORY = 600.0
"""Seconds of driving that are looked at."""

MOST_RECORDS = 400
ASIDE = math.radians(12.0)
"""A robot that has turned so far from where a visit began looks to another heading."""

LONGEST_VISIT = 4.0
"""Seconds after which a visit to a heading is recorded, though the robot has not turned away."""

MOST_IN_A_ROW = 3
"""Records of one heading; the next one takes the place of the last."""

SAMPLING = 0.08
"""Seconds between samples of a visit: more would only cost."""

LOOK_EVERY = 15.0
CONFIRM = 60.0
"""Seconds for which every look must say the same before it is believed."""


@dataclass(frozen=True)
class Watched:
    """What the last minutes of driving say.

    Parameters
    ----------
    is_stale : bool
        Whether the calibration no longer holds.
    findings : tuple of Finding
        Everything measured at the last look; while stale, at the one that showed it.
    minutes : float
        Since when it does not hold, in minutes before the newest look; zero while it holds.
    hard_iron : tuple of float
        Change of the hard iron in the IMU's x and y, tesla.
    was_judged : bool
        Whether it could be judged at all since it is in force.
    lacking : str
        What has not been seen in the last minutes; empty if they were judged.
    """

    is_stale: bool = False
    findings: tuple[Finding, ...] = ()
    minutes: float = 0.0
    hard_iron: tuple[float, float] = (0.0, 0.0)
    was_judged: bool = False
    lacking: str = "the robot has not driven yet"

    @property
    def summary(self) -> str:
        """One or two sentences for a person."""
        window = f"{self.lacking}, in the last {MEMORY / 60.0:.0f} minutes"
        if self.is_stale:
            causes = "; ".join(words for words in map(self._words, self.findings) if words)
            since = f"for about {max(self.minutes, 1.0):.0f} min"
            return f"The calibration has not held {since}: {causes}."
        if not self.was_judged:
            return f"Not judged yet: {window}."
        if self.lacking:
            return f"The calibration held when it was last judged; now {window}."
        return "The calibration holds on the headings of the last minutes."

    def _words(self, finding: Finding) -> str:
        if finding.state is State.HOLDS:
            return ""
        if finding.figure == "hard_iron_change":
            x, y = (1e6 * value for value in self.hard_iron)
            return f"{finding.words} (about {x:+.1f}, {y:+.1f} µT in the IMU's x, y)"
        return finding.words


class Watch:
    """Watches one calibration.

    Parameters
    ----------
    calibration : Calibration
        What is in force, and what it promised.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._calibration = calibration
        self._records: deque[Record] = deque(maxlen=MOST_RECORDS)
        self._visit: list[Record] = []
        self._newest = self._sampled = -math.inf
        self._rate = math.nan
        self._turned = 0.0
        self._path = 0
        self._looked = -math.inf
        self._doubts_since: float | None = None
        self._clear_since: float | None = None
        self._stale_since = 0.0
        self._watched = Watched()

    @property
    def watched(self) -> Watched:
        """What is known by now."""
        return self._watched

    def add(self, stamp: float, field: Triple, force: Triple, yaw: float, rate: Triple) -> None:
        """Take a corrected field sample.

        Parameters
        ----------
        stamp : float
            Seconds.
        field : tuple of float
            Corrected, body axes, tesla.
        force : tuple of float
            Along up as it was used for the yaw, body axes, any length.
        yaw : float
            The heading made of both, radians.
        rate : tuple of float
            Angular rate, rad/s; NaN without a gyro.
        """
        size = length(force)
        if size <= 0.0:
            return
        self._carry(stamp, dot(rate, force) / size)
        if stamp - self._sampled < SAMPLING:
            return
        self._sampled = stamp
        if force[0] ** 2 > STEEPEST_NOSE * size * size:
            self._close()
            return
        rise = dot(field, force) / size
        if self._visit:
            first = self._visit[0]
            aside = wrapped(yaw - first.yaw)
            has_turned = max(abs(aside), abs(self._turned - first.turned)) > ASIDE
            if has_turned or stamp - first.stamp > LONGEST_VISIT:
                self._close()
            else:
                yaw = first.yaw + aside
        turn = self._rate if math.isfinite(self._rate) else 0.0
        row = Record(stamp, yaw, length(field), rise, self._turned, self._path, turn)
        self._visit.append(row)

    def _carry(self, stamp: float, rate: float) -> None:
        """Follow the gyro's path; a gap parts it, and time that went back starts all over."""
        step = stamp - self._newest
        if step < 0.0:
            self._records.clear()
            self._sampled = self._looked = -math.inf
            self._doubts_since = self._clear_since = None
        if not 0.0 <= step <= LONGEST_CARRY:
            self._path += 1
            self._visit.clear()
        elif math.isfinite(rate + self._rate):
            self._turned += 0.5 * step * (rate + self._rate)
        self._newest, self._rate = stamp, rate

    def _close(self) -> None:
        """Make one record of a visit, and look at all of them now and then."""
        if not self._visit:
            return
        rows = np.array(self._visit)
        self._visit.clear()
        stamp, yaw, strength, rise, turned, path, rate = np.median(rows, axis=0).tolist()
        record = Record(stamp, yaw, strength, rise, turned, int(path), rate)
        self._keep(record)
        if record.stamp - self._looked >= LOOK_EVERY:
            self._looked = record.stamp
            self._look(record.stamp)

    def _keep(self, record: Record) -> None:
        records = self._records
        tail = [records[-k] for k in range(1, min(MOST_IN_A_ROW, len(records)) + 1)]
        stays = [
            max(abs(wrapped(one.yaw - record.yaw)), abs(one.turned - record.turned)) < ASIDE
            for one in tail
        ]
        if len(stays) == MOST_IN_A_ROW and all(stays):
            records.pop()
        records.append(record)
        while records[0].stamp < record.stamp - MEMORY:
            records.popleft()

    def _look(self, now: float) -> None:
        records: FloatArray = np.array(self._records)
        # The newest half shows a change sooner, all of them one that needs many records.
        measured = measure(records[records[:, 0] > now - 0.5 * MEMORY], self._calibration)
        if not measured.contradicts:
            measured = measure(records, self._calibration)
        before = self._watched
        if not measured.findings:
            self._doubts_since = self._clear_since = None
            self._watched = Watched(
                before.is_stale,
                before.findings,
                self._minutes(now, before.is_stale),
                before.hard_iron,
                before.was_judged,
                measured.lacking,
            )
            return
        self._weigh(now, records, measured)

    def _weigh(self, now: float, records: FloatArray, measured: Measured) -> None:
        """Believe what every look of the last minute says; until then stay with the old word."""
        before = self._watched
        contradicts = measured.contradicts
        if contradicts:
            self._doubts_since, self._clear_since = self._doubts_since or now, None
        else:
            self._doubts_since, self._clear_since = None, self._clear_since or now
        since = self._doubts_since if contradicts else self._clear_since
        assert since is not None
        is_stale = before.is_stale
        if contradicts != is_stale and now - since >= CONFIRM:
            is_stale = contradicts
            self._stale_since = onset(records, self._calibration)
        keeps_words = is_stale and not contradicts
        self._watched = Watched(
            is_stale,
            before.findings if keeps_words else measured.findings,
            self._minutes(now, is_stale),
            before.hard_iron if keeps_words else measured.hard_iron,
            before.was_judged or not measured.lacking,
            measured.lacking,
        )

    def _minutes(self, now: float, is_stale: bool) -> float:
        return (now - self._stale_since) / 60.0 if is_stale else 0.0
