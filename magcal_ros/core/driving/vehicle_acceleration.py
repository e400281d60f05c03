"""The vehicle's acceleration by its speed, and the direction of travel by the force."""

from __future__ import annotations

import cmath
import math
from collections import deque
from typing import NamedTuple

from magcal_ros.core.driving.driving_tuning import ACCELERATION, MOUNTING, SpeedSource
from magcal_ros.core.driving.gyro_frame import GyroFrame, Tick
from magcal_ros.core.driving.speed import SpeedTrack
from magcal_ros.core.geometry.vec3 import Triple, minus
from magcal_ros.core.knowledge import CLEAR
from magcal_ros.core.up.filter import FILTER
from magcal_ros.core.up.propagation import LinearAcceleration


class Trip(NamedTuple):
    """From one stop to the next.

    `sign` is minus one backwards, `is_clear` whether the force has determined it, and `end` the
    stamp of the stop.
    """

    sign: float = 1.0
    is_clear: bool = False
    end: float = math.inf


class VehicleAcceleration:
    """Measures the vehicle's acceleration, and the direction of travel.

    Over the last second with a known speed, the mean force minus the change of velocity is
    gravity, in the frame stabilised by the gyro. It is rotated into the present body axes, so that
    a speed with latency or at 1 Hz can be used.

    `turn` is the force over the change of velocity of an IMU that faces ahead: its angle is minus
    the IMU's yaw, and noise of the speed makes it smaller than one. `error` is its relative sigma,
    by yaw and scale. `noise` (m/s²) and `density` (m²/s³) are the residual of the force and its
    spectral density. While `is_yaw_known` is false, a vehicle is assumed to drive forwards.
    """

    def __init__(self) -> None:
        self.turn, self.error, self.is_yaw_known = 1.0 + 0j, 0.0, False
        self.noise = 0.3
        self.density = 2.0 * self.noise**2 * FILTER.acceleration_lasts
        self._waiting: deque[Tick] = deque(maxlen=64)
        self._matched: deque[tuple[Tick, complex]] = deque()
        self._key: tuple[SpeedSource, float] | None = None
        self.restart()

    def restart(self) -> None:
        """Forget all ticks: the gyro's frame has changed."""
        self._waiting.clear()
        self._before, self._trip, self._moves = Trip(end=-math.inf), Trip(), False
        self._odds = 0.0
        self._rest = 0j
        self._try_anew()

    def _try_anew(self) -> None:
        self._matched.clear()
        # Stamp, gravity, and the size of the acceleration that was subtracted for it, m/s².
        self._gravity: tuple[float, Triple, float] | None = None

    @property
    def is_measured(self) -> bool:
        """Whether the acceleration is measured."""
        return self.is_yaw_known and self._gravity is not None

    @property
    def sign(self) -> float:
        """Minus one while a vehicle with an unsigned speed reverses, else one."""
        return self._trip.sign

    def trip_at(self, stamp: float) -> Trip:
        """Return the trip at a stamp; its end is infinite as long as it lasts."""
        return self._trip if stamp > self._before.end else self._before

    def is_open(self, trip: Trip) -> bool:
        """Whether the force may still determine the direction of a trip."""
        return self.is_yaw_known and not trip.is_clear and trip.end == math.inf

    def add(self, tick: Tick, track: SpeedTrack | None) -> list[tuple[Tick, float]]:
        """Add a tick; return the ticks that were matched with a speed (m/s, NaN if unknown)."""
        self._waiting.append(tick)
        key = None if track is None else (track.source, track.delay)
        if key != self._key:
            # After a change of source or latency, differences of velocity are not valid.
            self._key = key
            self._try_anew()
        met: list[tuple[Tick, float]] = []
        while self._waiting:
            first = self._waiting[0]
            is_late = tick.stamp - first.stamp > ACCELERATION.oldest
            if track is not None and not track.has_passed(first.stamp) and not is_late:
                break
            self._waiting.popleft()
            speed = math.nan if track is None else track.at(first.stamp)
            if track is None or math.isnan(speed):
                self._try_anew()
            else:
                self._meet(first, speed, track)
            met.append((first, speed * self.sign))
        return met

    def linear(self, stamp: float, force: Triple, frame: GyroFrame) -> LinearAcceleration | None:
        """Return the acceleration at a specific force, m/s², body axes; None if unknown."""
        since, gravity, size = self._gravity or (math.inf, force, 0.0)
        if not (self.is_yaw_known and 0.0 <= stamp - since <= ACCELERATION.oldest):
            return None
        by_turn = (size * self.error) ** 2
        variance = self.noise**2 + by_turn
        density = self.density + 2.0 * by_turn * FILTER.speed_lasts
        own = minus(force, frame.to_body(gravity))
        return LinearAcceleration(own, math.sqrt(variance), density / (2.0 * variance))

    def _meet(self, tick: Tick, speed: float, track: SpeedTrack) -> None:
        moves = abs(speed) > ACCELERATION.speed_at_rest
        if self._moves and not moves:
            self._before = self._trip._replace(end=tick.stamp)
            self._trip = Trip()
            self._odds = 0.0
        self._moves = moves
        self._matched.append((tick, speed * cmath.exp(1j * tick.yaw)))
        if len(self._matched) > MOUNTING.smooth:
            self._subtract(track)
            self._matched.popleft()

    def _subtract(self, track: SpeedTrack) -> None:
        """Subtract the change of velocity over some ticks from the mean force."""
        (begin, old), *others = self._matched
        end, new = others[-1]
        seconds = sum(tick.seconds for tick, _ in others)
        if not 0.5 * seconds < end.stamp - begin.stamp < 1.5 * seconds:
            return
        x, y, z = (
            sum(tick.force[axis] * tick.seconds for tick, _ in others) / seconds
            for axis in range(3)
        )
        own = (new - old) / seconds * self.turn
        # A slope of the road and the accelerometer's bias are no change of velocity.
        seen = complex(x, y) - self._rest
        product = (seen * own.conjugate()).real
        if self.is_yaw_known and self._moves and not track.is_signed:
            self._decide(product)
        own *= self.sign
        self._rest += end.seconds / ACCELERATION.memory * (seen - own)
        self._gravity = (end.stamp, (x - own.real, y - own.imag, z), abs(own))

    def _decide(self, product: float) -> None:
        """Accumulate the evidence for the direction of travel since the last stop.

        The evidence is bounded, as a speed at 1 Hz may miss a stop.
        """
        most = 2.0 * CLEAR**2  # the log odds of a force of this many sigmas
        odds = self._odds + 2.0 * product / (MOUNTING.smooth * self.noise**2)
        self._odds = min(max(odds, -most), most)
        if abs(self._odds) == most:
            self._trip = Trip(math.copysign(1.0, self._odds), True)
