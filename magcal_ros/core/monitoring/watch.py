"""Whether a calibration still holds while the robot drives, from message to message.

Each visit to a heading leaves one record, and a robot at rest leaves no more of them, so that
neither a long pause beside a car nor a long straight road has much weight. Only what many headings
show together, and for a while, counts as a change.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.assessment.grading import Check, Grade
from magcal_ros.core.calibration import Calibration, Figure
from magcal_ros.core.geometry import FloatArray, wrapped
from magcal_ros.core.geometry.vec3 import Triple, dot, length
from magcal_ros.core.heading.compass import Moment
from magcal_ros.core.monitoring.watch_fit import Measured, Record, WatchTuning, measure, onset
from magcal_ros.core.samples.streams import STREAMS


@dataclass(frozen=True)
class Watched:
    """What the last minutes of driving show."""

    is_stale: bool = False
    """Whether the calibration no longer holds."""
    findings: tuple[Check, ...] = ()
    """Everything measured at the last look; while stale, at the one that showed it."""
    minutes: float = 0.0
    """Since when it does not hold, in minutes before the newest look; zero while it holds."""
    hard_iron: tuple[float, float] = (0.0, 0.0)
    """Change of the hard iron in the IMU's x and y, tesla."""
    was_judged: bool = False
    """Whether it could be judged at all since it is in force."""
    lacking: str = "the robot has not driven yet"
    """What has not been seen in the last minutes; empty if they were judged."""
    memory: float = WatchTuning.memory
    """Seconds of driving that are looked at."""

    @property
    def summary(self) -> str:
        """One or two sentences for a person."""
        window = f"{self.lacking}, in the last {self.memory / 60.0:.0f} minutes"
        if self.is_stale:
            causes = "; ".join(words for words in map(self._words, self.findings) if words)
            since = f"for about {max(self.minutes, 1.0):.0f} min"
            return f"The calibration has not held {since}: {causes}."
        if not self.was_judged:
            return f"Not judged yet: {window}."
        if self.lacking:
            return f"The calibration held when it was last judged; now {window}."
        return "The calibration holds on the headings of the last minutes."

    def _words(self, finding: Check) -> str:
        if finding.grade.rank < Grade.WARN.rank:
            return ""
        if finding.figure is Figure.HARD_IRON_CHANGE:
            x, y = (1e6 * value for value in self.hard_iron)
            return f"{finding.words} (about {x:+.1f}, {y:+.1f} µT in the IMU's x, y)"
        return finding.words


class Watch:
    """Watches one calibration."""

    def __init__(self, calibration: Calibration, tuning: WatchTuning = WatchTuning()) -> None:
        self._calibration = calibration
        self._tuning = tuning
        self._records: deque[Record] = deque(maxlen=tuning.most_records)
        self._visit: list[Record] = []
        self._newest = self._sampled = -math.inf
        self._rate = math.nan
        self._turned = 0.0
        self._path = 0
        self._looked = -math.inf
        self._doubts_since: float | None = None
        self._clear_since: float | None = None
        self._stale_since = 0.0
        self.watched = Watched(memory=tuning.memory)

    def take(self, moment: Moment) -> None:
        """Take a field message that has an up, a heading and a rate."""
        stamp, field, up, heading, rate = moment
        if up is not None and heading is not None and rate is not None:
            self.add(stamp, field, up.direction, heading.yaw, rate)

    def add(self, stamp: float, field: Triple, force: Triple, yaw: float, rate: Triple) -> None:
        """Take a corrected field sample (body axes, tesla) with the force along up, any length.

        `yaw` (rad) is the heading made of both; the angular rate (rad/s) is NaN without a gyro.
        """
        size = length(force)
        if size <= 0.0:
            return
        self._propagate(stamp, dot(rate, force) / size)
        if stamp - self._sampled < self._tuning.sampling:
            return
        self._sampled = stamp
        if force[0] ** 2 > self._tuning.steepest_nose * size * size:
            self._close()
            return
        rise = dot(field, force) / size
        if self._visit:
            first = self._visit[0]
            aside = wrapped(yaw - first.yaw)
            has_turned = max(abs(aside), abs(self._turned - first.turned)) > self._tuning.aside
            if has_turned or stamp - first.stamp > self._tuning.longest_visit:
                self._close()
            else:
                yaw = first.yaw + aside
        turn = self._rate if math.isfinite(self._rate) else 0.0
        row = Record(stamp, yaw, length(field), rise, self._turned, self._path, turn)
        self._visit.append(row)

    def _propagate(self, stamp: float, rate: float) -> None:
        """Integrate the gyro; a gap begins another path, and a jump of time clears the records."""
        step = stamp - self._newest
        if not 0.0 <= step <= self._tuning.memory:
            self._records.clear()
            self._sampled = self._looked = -math.inf
            self._doubts_since = self._clear_since = None
            if math.isfinite(step):
                self._stale_since += step
        if not 0.0 <= step <= STREAMS.longest_gyro_step:
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
        if record.stamp - self._looked >= self._tuning.look_every:
            self._looked = record.stamp
            self._look(record.stamp)

    def _keep(self, record: Record) -> None:
        records, tuning = self._records, self._tuning
        tail = [records[-k] for k in range(1, min(tuning.most_in_a_row, len(records)) + 1)]
        stays = [
            max(abs(wrapped(one.yaw - record.yaw)), abs(one.turned - record.turned)) < tuning.aside
            for one in tail
        ]
        if len(stays) == tuning.most_in_a_row and all(stays):
            records.pop()
        records.append(record)
        while records[0].stamp < record.stamp - tuning.memory:
            records.popleft()

    def _look(self, now: float) -> None:
        records: FloatArray = np.array(self._records)
        # The newest half shows a change sooner, all of them one that needs many records.
        late = records[records[:, 0] > now - 0.5 * self._tuning.memory]
        measured = measure(late, self._calibration, self._tuning)
        if not measured.contradicts:
            measured = measure(records, self._calibration, self._tuning)
        before = self.watched
        if not measured.findings:
            self._doubts_since = self._clear_since = None
            minutes = self._minutes(now, before.is_stale)
            self.watched = replace(before, minutes=minutes, lacking=measured.lacking)
            return
        self._weigh(now, records, measured)

    def _weigh(self, now: float, records: FloatArray, measured: Measured) -> None:
        """Adopt what every look of the last minute shows; until then keep the previous finding."""
        before = self.watched
        contradicts = measured.contradicts
        if contradicts:
            self._doubts_since, self._clear_since = self._doubts_since or now, None
        else:
            self._doubts_since, self._clear_since = None, self._clear_since or now
        since = self._doubts_since if contradicts else self._clear_since
        assert since is not None
        is_stale = before.is_stale
        if contradicts != is_stale and now - since >= self._tuning.confirm:
            is_stale = contradicts
            self._stale_since = onset(records, self._calibration, self._tuning)
        keeps_words = is_stale and not contradicts
        self.watched = Watched(
            is_stale,
            before.findings if keeps_words else measured.findings,
            self._minutes(now, is_stale),
            before.hard_iron if keeps_words else measured.hard_iron,
            before.was_judged or not measured.lacking,
            measured.lacking,
            self._tuning.memory,
        )

    def _minutes(self, now: float, is_stale: bool) -> float:
        return (now - self._stale_since) / 60.0 if is_stale else 0.0
