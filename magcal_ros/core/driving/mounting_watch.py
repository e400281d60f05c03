"""Follows a drive: the yaw of the IMU in the vehicle, and whether the speed can be trusted."""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

import numpy as np

from magcal_ros.core.driving.chords import Tick
from magcal_ros.core.driving.driving_tuning import MOUNTING, OWN, TICKS, SpeedSource
from magcal_ros.core.driving.mounting_yaw import (
    MountingYaw,
    TickTable,
    correlation,
    fit_mounting_yaw,
)
from magcal_ros.core.driving.speedometer import Speedometer, SpeedRecord

UNITS = {3.6: "km/h", 2.237: "mph", 1.944: "knots", 100.0: "cm/s", 1000.0: "mm/s"}
"""How often each is in a m/s."""


class SpeedFault(str, Enum):
    """What is wrong with a speed."""

    JUMPS = "jumps"
    FROZEN = "frozen"
    SCALE = "scale"
    LATE = "late"
    UNRELATED = "unrelated"


class Judged(NamedTuple):
    """What a fit shows of one source: the yaw it leads to, what is wrong with it, its latency."""

    source: SpeedSource
    fitted: MountingYaw | None
    fault: SpeedFault | None
    delay: float

    @property
    def is_good(self) -> bool:
        """Whether it shows the yaw, and no fault is known."""
        return self.fitted is not None and self.fault is None


class MountingWatch:
    """Keeps the ticks of some minutes and fits them now and then.

    `found` is the newest fit of the source in use, `seen` that of each source, and `faults` is what
    is wrong with which source.
    """

    def __init__(self, speedometer: Speedometer) -> None:
        self._speedometer = speedometer
        self._ticks: deque[Tick] = deque(maxlen=MOUNTING.remembered)
        self._fitted_at = -math.inf
        self._fits = 0
        self._still = 0.0
        self._speed, self._level, self._unmoved = math.nan, 0j, 0.0
        self.found: MountingYaw | None = None
        self.faults: dict[SpeedSource, SpeedFault] = {}
        self.seen: dict[SpeedSource, MountingYaw] = {}

    @property
    def known(self) -> MountingYaw | None:
        """The yaw, where enough was seen to determine it."""
        found = self.found
        return found if found is not None and found.is_known else None

    def add(self, tick: Tick, speed: float) -> bool:
        """Take a tick and its speed (m/s, NaN where unknown); returns whether a fit is due."""
        self._still = 0.0 if abs(speed) > MOUNTING.moving else self._still + tick.seconds
        is_quiet = abs(tick.level_force) < 0.5 * MOUNTING.moving
        if self._still < MOUNTING.standing or not is_quiet:
            self._ticks.append(tick)
        is_urgent = len(self._ticks) * tick.seconds < 60.0 or self._looks_stuck(tick, speed)
        return tick.stamp - self._fitted_at >= (
            MOUNTING.reuse_first if is_urgent else MOUNTING.reuse
        )

    def _looks_stuck(self, tick: Tick, speed: float) -> bool:
        """Whether the force changes while the speed does not."""
        change = tick.level_force - self._level
        self._level += change / MOUNTING.highpass
        self._unmoved += abs(change) ** 2 * tick.seconds
        if speed != self._speed:
            self._speed, self._unmoved = speed, 0.0
        return self._unmoved > MOUNTING.first_energy

    def restart(self) -> None:
        """Forget the ticks: time was set back."""
        self._ticks.clear()
        self._fitted_at = -math.inf

    def begin_fit(self, stamp: float) -> Callable[[], tuple[Judged, ...]]:
        """Return the work of fitting what was driven, for any thread; give `take` its result.

        The sources after the first good one wait for every fourth fit, which measures latencies.
        """
        self._fitted_at = stamp
        self._fits += 1
        table, is_thorough = self._table(), self._fits % 4 == 0
        recent = [
            (source, track.record())
            for source, track in self._speedometer.tracks.items()
            if stamp - track.newest <= MOUNTING.reuse
        ]

        def work() -> tuple[Judged, ...]:
            judged: list[Judged] = []
            for source, record in recent:
                judged.append(_judged(source, table, record, is_thorough))
                if judged[-1].is_good and not is_thorough:
                    break
            return tuple(judged)

        return work

    def take(self, judged: tuple[Judged, ...]) -> None:
        """Take over what was fitted: the best source without a fault is used."""
        self.found = None
        for each in judged:
            if each.fitted is not None:
                self.seen[each.source] = each.fitted
            self._speedometer.tracks[each.source].delay = each.delay
            if each.fault is None:
                self.faults.pop(each.source, None)
                self._speedometer.distrusted.discard(each.source)
                self.found = self.found or each.fitted
            else:
                self.faults[each.source] = each.fault
                self._speedometer.distrusted.add(each.source)

    def _table(self) -> TickTable:
        """Return the ticks in arrays, without speeds."""
        stamp = np.array([tick.stamp for tick in self._ticks])
        force = np.array([tick.level_force for tick in self._ticks], dtype=np.complex128)
        seconds, yaw, rate = (
            np.array([tick[column] for tick in self._ticks], dtype=np.float64)
            for column in (1, 3, 4)
        )
        return TickTable(stamp, seconds, force, yaw, rate, np.full(len(stamp), math.nan))


def _judged(
    source: SpeedSource, table: TickTable, record: SpeedRecord, measures_delay: bool
) -> Judged:
    delay = _delay(table, record) if measures_delay else record.delay
    met = _met(table, record, delay)
    is_rough = source is not SpeedSource.ODOMETRY

    def fitted(ticks: TickTable) -> MountingYaw | None:
        found = fit_mounting_yaw(ticks, delay)
        return None if found is None else dataclasses.replace(found, is_rough=is_rough)

    newest = _last(met, MOUNTING.stuck)
    if len(newest.speed) == MOUNTING.stuck and np.ptp(newest.speed) == 0.0:
        stuck = fitted(newest)
        if (
            stuck is not None
            and stuck.force_energy > MOUNTING.first_energy
            and stuck.explained < MOUNTING.explained
        ):
            return Judged(source, stuck, SpeedFault.FROZEN, delay)
    # What went wrong just now is not outweighed by minutes in which all was well.
    recent = fitted(_last(met, MOUNTING.recent))
    fault = None if recent is None else _fault(record, recent)
    if fault is not None:
        return Judged(source, recent, fault, delay)
    found = fitted(met)
    fault = None if found is None else _fault(record, found)
    return Judged(source, found, fault, delay)


def _delay(table: TickTable, record: SpeedRecord) -> float:
    """Find the shift at which force and change of velocity go together best."""
    step = 2.0 * TICKS.seconds
    if len(table.stamp) < 2 * MOUNTING.highpass:
        return record.delay
    delays = np.arange(MOUNTING.earliest_delay, MOUNTING.largest_delay + step, step)
    scores = np.array([correlation(_met(table, record, d)) for d in delays])
    best = int(np.argmax(scores))
    now = float(np.interp(record.delay, delays, scores))
    is_clear = scores[best] ** 2 > MOUNTING.explained and scores[best] > now + 0.02
    if not is_clear or best in (0, len(delays) - 1):
        return record.delay
    before, top, after = scores[best - 1 : best + 2]
    bend = before - 2.0 * top + after
    shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float(delays[best] + step * shift)


def _fault(record: SpeedRecord, fitted: MountingYaw) -> SpeedFault | None:
    if record.wild_share > MOUNTING.wild:
        return SpeedFault.JUMPS
    if fitted.force_energy < MOUNTING.energy:
        return None
    if fitted.energy < 0.02 * fitted.force_energy:
        return SpeedFault.FROZEN
    if fitted.explained < MOUNTING.explained:
        return SpeedFault.UNRELATED
    if not fitted.has_scale:
        return SpeedFault.SCALE
    return SpeedFault.LATE if fitted.delay > OWN.latest else None


def _met(table: TickTable, record: SpeedRecord, delay: float) -> TickTable:
    """Return ticks with the speeds of a source at a latency."""
    speed = record.along(table.stamp, delay)
    return dataclasses.replace(table, speed=speed, is_signed=record.is_signed)


def _last(table: TickTable, count: int) -> TickTable:
    """Return the newest ticks."""
    columns = ("stamp", "seconds", "force", "yaw", "turn_rate", "speed")
    newest = {name: getattr(table, name)[-count:] for name in columns}
    return dataclasses.replace(table, **newest)


def fault_words(topic: str, fault: SpeedFault, fitted: MountingYaw) -> str:
    """Say what is wrong with a speed, and what to do."""
    if fault is SpeedFault.SCALE:
        times = 1.0 / max(fitted.scale, 1e-6)
        unit = next((name for k, name in UNITS.items() if abs(times / k - 1.0) < 0.12), "")
        guess = f", as if it were in {unit}" if unit else ""
        what = f"is {times:.2g} times what the accelerometer says{guess}: publish m/s"
    else:
        what = {
            SpeedFault.JUMPS: "jumps as no vehicle can: look at the encoder or its driver",
            SpeedFault.FROZEN: "does not change while the accelerometer says that the vehicle "
            "moves: is its driver stuck?",
            SpeedFault.LATE: f"is late by {fitted.delay:.1f} s: stamp it when it is measured",
            SpeedFault.UNRELATED: "does not go with the accelerometer: is it this vehicle's, and "
            "stamped by the same clock?",
        }[fault]
    return f"{topic}: its speed {what}. It is not used"
