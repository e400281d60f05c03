"""Test of whether a calibration holds while the robot drives, from message to message.

Each visit to a heading gives one record, and a robot at rest gives no further ones: a long pause
beside a car or a long straight road has little weight. A change must be visible at many headings
for some time.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.assessment.grading import Bound, Check, Grade
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import known_sigma
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import wrapped
from magcal_ros.core.geometry.vec3 import dot, length
from magcal_ros.core.heading.compass import CompassReading
from magcal_ros.core.monitoring.change import (
    CHANGE,
    GYRO_BOUND,
    ONCE,
    SECTOR,
    TWICE,
    Record,
    check_beside_chance,
    compass_minus_gyro,
    fit_harmonics,
    harmonics,
    records_of,
)
from magcal_ros.core.samples.coverage import Coverage
from magcal_ros.core.samples.streams import STREAMS

AGAIN = "calibrate again"
ELSEWHERE = (
    "the robot has moved to another place, or iron above or below the sensor has changed; give the "
    "reference field of this place and calibrate here"
)
WATCH_BOUNDS: tuple[Bound, ...] = (
    Bound(
        Figure.HARD_IRON_CHANGE,
        (None, 3.5, 10.0),
        "the level hard iron has changed, relative to the field's strength, by",
        f"something magnetic was added to the robot, taken off or moved; {AGAIN}",
        unit="%",
    ),
    Bound(
        Figure.SOFT_IRON_CHANGE,
        (None, 4.0, 10.0),
        "the field's strength swings twice per turn, as soft iron causes it, by",
        f"iron near the sensor or a gain of the sensor has changed; {AGAIN}",
        unit="%",
    ),
    Bound(
        Figure.MOUNTING_CHANGE,
        (None, 3.0, 8.0),
        "the field has tilted against gravity by",
        f"the magnetometer or the IMU was moved on the robot; {AGAIN}",
    ),
    Bound(
        Figure.STRENGTH_SHIFT,
        (None, 8.0, 15.0),
        "at all headings the field's strength differs from the calibrated one by",
        ELSEWHERE,
        unit="%",
    ),
    Bound(
        Figure.DIP_SHIFT,
        (None, 4.0, 8.0),
        "at all headings the inclination differs from the calibrated one by",
        ELSEWHERE,
    ),
    replace(GYRO_BOUND, figure=Figure.GYRO_COMPASS_HARMONIC),
)
"""As for a recheck, but the records of a drive show what has changed."""


@dataclass(frozen=True)
class MonitorTuning:
    """How a drive is tested."""

    memory: float = 600.0  # seconds of driving that are used
    most_records: int = 400  # visits that are kept at most
    most_in_a_row: int = 3  # records of one heading; the next one replaces the last
    look_every: float = 15.0  # seconds between two tests
    confirm: float = 60.0  # seconds for which every test must agree before the state changes
    shortest_span: float = 150.0  # seconds of records: passing disturbances are shorter
    predicted: float = 3.0  # predicted standard deviations of the heading that are no change
    lost: float = math.radians(20.0)
    """Radians of compass against gyro from which a compass is wrong, even with few headings."""


MONITOR = MonitorTuning()


@dataclass(frozen=True)
class MonitorResult:
    """The result of the last minutes of driving."""

    is_stale: bool = False  # whether the calibration no longer holds
    findings: tuple[Check, ...] = ()
    """The checks of the last test; while stale, of the one that detected it."""
    minutes: float = 0.0  # for how long it has not held, before the newest test
    hard_iron: tuple[float, float] = (0.0, 0.0)  # its change in x and y, tesla
    was_judged: bool = False  # whether it could be judged at all since it is in force
    missing_data: str = "the robot has not driven yet"
    """The data that are missing in the last minutes; empty if they were judged."""

    @property
    def summary(self) -> str:
        """One or two sentences."""
        window = f"{self.missing_data}, in the last {MONITOR.memory / 60.0:.0f} minutes"
        if self.is_stale:
            causes = "; ".join(words for words in map(self._words, self.findings) if words)
            since = f"for about {max(self.minutes, 1.0):.0f} min"
            return f"The calibration has not held {since}: {causes}."
        if not self.was_judged:
            return f"Not judged yet: {window}."
        if self.missing_data:
            return f"The calibration held when it was last judged; now {window}."
        return "The calibration holds on the headings of the last minutes."

    def _words(self, finding: Check) -> str:
        if finding.grade.rank < Grade.WARN.rank:
            return ""
        if finding.figure is Figure.HARD_IRON_CHANGE:
            x, y = (1e6 * value for value in self.hard_iron)
            return f"{finding.words} (about {x:+.1f}, {y:+.1f} µT in the IMU's x, y)"
        return finding.words


def measure(
    records: FloatArray, calibration: Calibration
) -> tuple[tuple[Check, ...], tuple[float, float]]:
    """Compare the records (n, 7) of a drive with the calibration.

    Returns the findings beyond chance, and the hard iron's change, tesla in body x and y.
    """
    figures, iron = _gyro_figure(records), (0.0, 0.0)
    if not missing_data(records):
        swings, iron = _swings(records, calibration)
        figures |= swings
    sigma, level = MONITOR.predicted * known_sigma(calibration), math.cos(calibration.inclination)
    own = {
        Figure.HARD_IRON_CHANGE: sigma * level,
        Figure.SOFT_IRON_CHANGE: sigma,
        Figure.GYRO_COMPASS_HARMONIC: sigma,
    }
    findings = []
    for bound in WATCH_BOUNDS:
        figure, chance = figures.get(bound.figure, (0.0, 0.0))
        if figure > chance:
            chance = math.hypot(chance, own.get(bound.figure, 0.0))
            findings.append(check_beside_chance(bound, figure, chance, decided=True))
    return tuple(findings), iron


def missing_data(records: FloatArray) -> str:
    """Return the missing data in words; empty if the records are enough to judge swings."""
    if len(records) < 2:
        return "the robot has not driven yet"
    gap = Coverage.of(records[:, 1]).gap
    if gap > CHANGE.widest_hole:
        return f"not enough headings ({math.degrees(gap):.0f}° of heading were not driven)"
    return "" if np.ptp(records[:, 0]) >= MONITOR.shortest_span else "not enough driving yet"


def _swings(
    records: FloatArray, calibration: Calibration
) -> tuple[dict[Figure, tuple[float, float]], tuple[float, float]]:
    """Return the figures over headings with their limits by chance, and the hard iron's change."""
    stamp, yaw, rate = records[:, 0], records[:, 1], records[:, 6]
    strength, rise = (records[:, 2:4] / calibration.strength).T
    level = math.cos(calibration.inclination)
    columns = harmonics(yaw)
    by_strength = fit_harmonics(columns, strength, stamp, CHANGE.clearly)
    # In curves the measured up tilts with the yaw rate, which changes the rise.
    in_curves = np.column_stack([columns[:, :3], rate * columns[:, 2]])
    lean = 3, level * CHANGE.fastest_curve
    by_rise = fit_harmonics(in_curves, rise, stamp, CHANGE.clearly, lean)
    mean, up = float(by_strength.values[0]), float(by_rise.values[0])
    dip = math.atan2(-up, math.sqrt(max(mean**2 - up**2, 0.0)))
    figures = {Figure.STRENGTH_SHIFT: (abs(mean - 1.0), 0.0)}
    figures[Figure.DIP_SHIFT] = abs(dip - calibration.inclination), 0.0
    for figure, fit, part, scale in (
        (Figure.HARD_IRON_CHANGE, by_strength, ONCE, level),
        (Figure.SOFT_IRON_CHANGE, by_strength, TWICE, level**2),
        (Figure.MOUNTING_CHANGE, by_rise, ONCE, level),
    ):
        size, chance = fit.amplitude(part)
        figures[figure] = size / scale, chance / scale
    x, y = by_strength.values[ONCE] * (calibration.strength / level)
    return figures, (float(x), float(y))


def _gyro_figure(records: FloatArray) -> dict[Figure, tuple[float, float]]:
    """Return the RMS swing of compass minus gyro, or its median if few headings were seen."""
    name = Figure.GYRO_COMPASS_HARMONIC
    if np.ptp(records[:, 0]) < MONITOR.shortest_span or np.ptp(records[:, 4]) < math.tau:
        return {}
    gyro = compass_minus_gyro(records, records[:, 1], CHANGE.clearly)
    if gyro is None:
        return {}
    if missing_data(records) or gyro.waves is None:
        usual = float(np.median(np.abs(gyro.deviation)))
        return {name: (usual, 0.0)} if usual > MONITOR.lost else {}
    size, chance = gyro.waves.amplitude(ONCE)
    return {name: (size / math.sqrt(2.0), chance / math.sqrt(2.0))}


def onset(records: FloatArray, calibration: Calibration) -> float:
    """Return the stamp from which the records contradict the calibration.

    It is the change point that best separates records that fit the calibration from records that
    fit the harmonics of the newer half, by the sum of squared residuals. Each residual is limited,
    so that no single one decides.
    """
    columns = harmonics(records[:, 1])
    late = records[:, 0] >= np.median(records[:, 0])
    gain = np.zeros(len(records))
    for values, wanted in (
        (records[:, 2] / calibration.strength, 1.0),
        (records[:, 3] / calibration.strength, -math.sin(calibration.inclination)),
    ):
        found = fit_harmonics(columns[late], values[late], records[late, 0], 1.0).values
        misfits = np.abs([values - wanted, values - columns @ found])
        scatter = max(1.5 * float(np.median(misfits[1])), CHANGE.smallest_scatter)
        gain += np.subtract(*np.minimum((misfits / scatter) ** 2, 9.0))
    total = np.cumsum(np.append(0.0, gain))
    return float(records[min(int(np.argmin(total)), len(records) - 1), 0])


class CalibrationMonitor:
    """Tests one calibration during driving."""

    def __init__(self, calibration: Calibration) -> None:
        self._calibration = calibration
        self._records: deque[Record] = deque(maxlen=MONITOR.most_records)
        self._samples: list[Record] = []
        self._newest = -math.inf
        self._rate = math.nan
        self._turned = 0.0
        self._path = 0
        self._looked = -math.inf
        self._contradicted: bool | None = None
        self._since = -math.inf
        self._stale_since = 0.0
        self.result = MonitorResult()

    def take(self, reading: CompassReading) -> None:
        """Add a field message, which counts if it has an up, a heading and a rate."""
        stamp, field, seen, heading, rate = reading
        if seen is None or heading is None or rate is None:
            return
        up = seen.direction
        self._propagate(stamp, dot(rate, up))
        if up[0] ** 2 > CHANGE.steepest_nose:
            return
        turn = self._rate if math.isfinite(self._rate) else 0.0
        values = heading.yaw, length(field), dot(field, up), self._turned, self._path, turn
        self._samples.append(Record(stamp, *values))
        if stamp - self._looked >= MONITOR.look_every:
            self._look(stamp)

    def _propagate(self, stamp: float, rate: float) -> None:
        """Integrate the gyro; a gap starts another path, and a jump of time clears the records."""
        step = stamp - self._newest
        if not 0.0 <= step <= MONITOR.memory:
            self._records.clear()
            self._samples.clear()
            self._looked = -math.inf
            self._contradicted = None
            if math.isfinite(step):
                self._stale_since += step
        if not 0.0 <= step <= STREAMS.longest_gyro_step:
            self._path += 1
        elif math.isfinite(rate + self._rate):
            self._turned += 0.5 * step * (rate + self._rate)
        self._newest, self._rate = stamp, rate

    def _keep(self, record: Record) -> None:
        records = self._records
        stays = [
            max(abs(wrapped(one.yaw - record.yaw)), abs(one.turned - record.turned)) < SECTOR
            for one in list(records)[-MONITOR.most_in_a_row :]
        ]
        if len(stays) == MONITOR.most_in_a_row and all(stays):
            records.pop()
        records.append(record)
        while records[0].stamp < record.stamp - MONITOR.memory:
            records.popleft()

    def _look(self, now: float) -> None:
        """Add the visits since the last test, and test all records."""
        samples = np.array(self._samples)
        self._samples.clear()
        self._looked = now
        for row in records_of(samples).tolist():
            self._keep(Record(*row))
        records: FloatArray = np.array(self._records)
        # The newest half shows a change sooner; all records show a smaller one.
        late = records[records[:, 0] > now - 0.5 * MONITOR.memory]
        findings: tuple[Check, ...] = ()
        for rows in (late, records):
            if not _contradicts(findings):
                findings, iron = measure(rows, self._calibration)
                missing = missing_data(rows)
        result, contradicts = replace(self.result, missing_data=missing), _contradicts(findings)
        if not findings:
            self._contradicted = None
        else:
            if contradicts is not self._contradicted:
                self._contradicted, self._since = contradicts, now
            if contradicts != result.is_stale and now - self._since >= MONITOR.confirm:
                result = replace(result, is_stale=contradicts)
                self._stale_since = onset(records, self._calibration)
            if contradicts or not result.is_stale:
                result = replace(result, findings=findings, hard_iron=iron)
            result = replace(result, was_judged=result.was_judged or not missing)
        minutes = (now - self._stale_since) / 60.0 if result.is_stale else 0.0
        self.result = replace(result, minutes=minutes)


def _contradicts(findings: tuple[Check, ...]) -> bool:
    """Whether anything differs from what the calibration predicts."""
    return any(finding.grade.rank >= Grade.WARN.rank for finding in findings)
