"""Follows a drive: the yaw of the IMU in the vehicle, and whether the speed is to be believed."""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from enum import Enum

import numpy as np

from magcal_ros.core.driving.driving_tuning import DrivingTuning
from magcal_ros.core.driving.gyro_frame import Tick
from magcal_ros.core.driving.mounting_yaw import (
    MountingYaw,
    TickTable,
    correlation,
    fit_mounting_yaw,
)
from magcal_ros.core.driving.speedometer import Speedometer, SpeedSource, SpeedTrack

UNITS = {3.6: "km/h", 2.237: "mph", 1.944: "knots", 100.0: "cm/s", 1000.0: "mm/s"}
"""How often each is in a m/s."""


class SpeedFault(str, Enum):
    """What is wrong with a speed."""

    JUMPS = "jumps"
    FROZEN = "frozen"
    SCALE = "scale"
    LATE = "late"
    UNRELATED = "unrelated"


class MountingWatch:
    """Keeps the ticks of some minutes and fits them now and then.

    Parameters
    ----------
    speedometer : Speedometer
        Who tells the speeds; sources that are found wrong are distrusted there.
    tuning : DrivingTuning, optional
        What is taken for granted.

    Attributes
    ----------
    found : MountingYaw or None
        The newest fit of the source in use.
    faults : dict of SpeedSource to (SpeedFault, MountingYaw)
        What is wrong with which source.
    """

    def __init__(self, speedometer: Speedometer, tuning: DrivingTuning | None = None) -> None:
        self._tuning = tuning or DrivingTuning()
        self._speedometer = speedometer
        self._ticks: deque[Tick] = deque(maxlen=self._tuning.mounting.remembered)
        self._fitted_at = -math.inf
        self._fits = 0
        self._still = 0.0
        self.found: MountingYaw | None = None
        self.faults: dict[SpeedSource, SpeedFault] = {}
        self.seen: dict[SpeedSource, MountingYaw] = {}

    @property
    def known(self) -> MountingYaw | None:
        """The yaw, where enough was seen to tell it."""
        found = self.found
        return found if found is not None and found.is_known(self._tuning.mounting) else None

    def add(self, tick: Tick, speed: float) -> bool:
        """Take a tick and its speed (m/s, NaN where unknown); returns whether a fit is due."""
        mounting = self._tuning.mounting
        self._still = 0.0 if abs(speed) > mounting.moving else self._still + tick.seconds
        is_quiet = abs(tick.level_force) < 0.5 * mounting.moving
        if self._still < mounting.standing or not is_quiet:
            self._ticks.append(tick)
        return tick.stamp - self._fitted_at >= mounting.reuse

    def restart(self) -> None:
        """Forget the ticks: time was set back."""
        self._ticks.clear()
        self._fitted_at = -math.inf

    def fit(self, stamp: float) -> None:
        """Fit what was driven, for every source that speaks; some milliseconds."""
        self._fitted_at = stamp
        self._fits += 1
        self.found = None
        if not self._ticks:
            return
        table = self._table()
        for source, track in self._speedometer.tracks.items():
            if stamp - track.newest > self._tuning.mounting.reuse:
                continue
            if self._fits % 3 == 0:
                self._measure_delay(table, track)
            fitted = self._fitted(table, track)
            # What went wrong just now is not outweighed by minutes in which all was well.
            recent = self._fitted(_last(table, self._tuning.mounting.recent), track)
            fault = None if recent is None else self._fault(track, recent)
            if fault is None and fitted is not None:
                fault = self._fault(track, fitted)
            elif recent is not None:
                fitted = recent
            self._note(source, fitted, fault)
            if fault is None and self.found is None:
                self.found = fitted

    def _note(
        self, source: SpeedSource, fitted: MountingYaw | None, fault: SpeedFault | None
    ) -> None:
        if fitted is not None:
            self.seen[source] = fitted
        if fault is None:
            self.faults.pop(source, None)
            self._speedometer.distrusted.discard(source)
        else:
            self.faults[source] = fault
            self._speedometer.distrusted.add(source)

    def _table(self) -> TickTable:
        """Return the ticks in arrays, without speeds."""
        stamp, seconds, force, yaw, turn_rate = zip(*self._ticks, strict=True)
        level = np.array(force)[:, :2] @ np.array([1.0, 1.0j])
        time, none = np.array(stamp), np.full(len(stamp), math.nan)
        return TickTable(time, np.array(seconds), level, np.array(yaw), np.array(turn_rate), none)

    def _fitted(self, table: TickTable, track: SpeedTrack) -> MountingYaw | None:
        met = _met(table, track, track.delay)
        return fit_mounting_yaw(met, track.delay, self._tuning.mounting, self._tuning.trip)

    def _measure_delay(self, table: TickTable, track: SpeedTrack) -> None:
        """Find the shift at which force and change of velocity go together best."""
        mounting, step = self._tuning.mounting, self._tuning.ticks.seconds
        if len(table.stamp) < 2 * mounting.highpass:
            return
        delays = np.arange(mounting.earliest_delay, mounting.largest_delay + step, step)
        scores = np.array([correlation(_met(table, track, d), mounting) for d in delays])
        best = int(np.argmax(scores))
        now = float(np.interp(track.delay, delays, scores))
        is_clear = scores[best] ** 2 > mounting.explained and scores[best] > now + 0.02
        if not is_clear or best in (0, len(delays) - 1):
            return
        before, top, after = scores[best - 1 : best + 2]
        bend = before - 2.0 * top + after
        shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
        track.delay = float(delays[best] + step * shift)

    def _fault(self, track: SpeedTrack, fitted: MountingYaw) -> SpeedFault | None:
        mounting = self._tuning.mounting
        if track.wild_share > 0.02:
            return SpeedFault.JUMPS
        if fitted.force_energy < 2.0 * mounting.energy:
            return None
        if fitted.energy < 0.02 * fitted.force_energy:
            return SpeedFault.FROZEN
        if fitted.explained < mounting.explained:
            return SpeedFault.UNRELATED
        if not mounting.lowest <= fitted.scale <= mounting.highest:
            return SpeedFault.SCALE
        if track.delay > self._tuning.own.oldest:
            return SpeedFault.LATE
        return None


def _met(table: TickTable, track: SpeedTrack, delay: float) -> TickTable:
    """Return ticks with the speeds of a source at a latency."""
    speed = track.along(table.stamp, delay)
    return dataclasses.replace(table, speed=speed, is_signed=track.is_signed)


def _last(table: TickTable, count: int) -> TickTable:
    """Return the newest ticks."""
    columns = (table.stamp, table.seconds, table.force, table.yaw, table.turn_rate, table.speed)
    return TickTable(*(column[-count:] for column in columns))  # type: ignore[arg-type]


def fault_words(topic: str, fault: SpeedFault, fitted: MountingYaw) -> str:
    """Say what is wrong with a speed, and what to do.

    Parameters
    ----------
    topic : str
        Where it comes from.
    fault : SpeedFault
        What was found.
    fitted : MountingYaw
        By what fit.
    """
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
