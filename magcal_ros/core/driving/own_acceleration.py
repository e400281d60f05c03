"""The vehicle's own acceleration, subtracted from the specific force at the speed's delay."""

from __future__ import annotations

import cmath
import math
from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple

from magcal_ros.core.driving.chords import GyroFrame, Tick
from magcal_ros.core.driving.driving_tuning import OWN, SpeedSource
from magcal_ros.core.driving.speedometer import SpeedTrack
from magcal_ros.core.geometry.vec3 import Triple, minus


@dataclass
class _Moments:
    """Running means of force and change of velocity, m/s², and second moments about them."""

    force: complex = 0j
    change: complex = 0j
    force_square: float = 0.0
    change_square: float = 0.0
    product: complex = 0j

    def add(self, force: complex, change: complex, gain: float) -> None:
        by_force, by_change = force - self.force, change - self.change
        self.force += gain * by_force
        self.change += gain * by_change
        keeps = 1.0 - gain
        self.force_square = keeps * (self.force_square + gain * abs(by_force) ** 2)
        self.change_square = keeps * (self.change_square + gain * abs(by_change) ** 2)
        self.product = keeps * (self.product + gain * by_force * by_change.conjugate())

    def square_left(self, turn: complex) -> float:
        """Return the variance of the force less `turn` times the change."""
        both = 2.0 * (turn.conjugate() * self.product).real
        return self.force_square - both + abs(turn) ** 2 * self.change_square


class _Trip(NamedTuple):
    """When a trip ended, which way it went, and whether the force had decided on that."""

    end: float = -math.inf
    sign: float = 1.0
    is_clear: bool = False


class OwnAcceleration:
    """Subtracts the vehicle's own acceleration from the force.

    Over the last half second that the speed is known for, the mean force less the change of
    velocity is gravity, in the frame that the gyro keeps still; it is turned into the body axes
    of the moment. So neither a late speed nor one that comes once a second does harm.

    `yaw` is that of the IMU in the vehicle, radians, zero until it is known. `scale` is the force
    over the change of speed, whose noise makes it less than one, and `noise` the m/s² by which the
    force departs from it. `is_used` is whether the speed explains the force of the last seconds.
    `is_yaw_usable` and `is_yaw_known` are whether the yaw is known roughly, and well: before the
    latter, a vehicle is taken to drive forwards. `sign` is minus one while a speed without sign is
    that of a vehicle that backs up, and `is_clear` is whether the force has decided on it since the
    vehicle stood.
    """

    def __init__(self) -> None:
        self.yaw, self.is_yaw_usable, self.is_yaw_known = 0.0, False, False
        self.scale, self.noise = 1.0, 0.3
        self._waiting: deque[Tick] = deque(maxlen=64)
        self._matched: deque[tuple[Tick, complex]] = deque(maxlen=max(OWN.spans.values()) + 1)
        self._is_rough, self._slow = False, OWN.slow[SpeedSource.ODOMETRY]
        self._is_signed, self._span = True, OWN.spans[SpeedSource.ODOMETRY]
        self._track_key: tuple[SpeedSource, float] | None = None
        self.restart()

    def restart(self) -> None:
        """Forget ticks: the gyro's frame is another one."""
        self._waiting.clear()
        self._gives, self._pauses_until = False, -math.inf
        self._before, self._is_under_way, self._speed = _Trip(), True, 0.0
        self.sign, self.is_clear = 1.0, False
        self._slope, self._product, self._energy = 0j, 0.0, 0.0
        self._try_anew()

    def _try_anew(self) -> None:
        self._matched.clear()
        self._gravity: tuple[float, Triple] | None = None
        self.is_used, self._tried = False, 0
        self._as_taken, self._reversed = _Moments(), _Moments()
        self._along = self._changes = 0.0

    def trip_at(self, stamp: float) -> tuple[float, bool, bool]:
        """Return the sign of a trip under way at a stamp, or that ended after it.

        And whether the force has decided on it, and whether it may still do so.
        """
        if stamp > self._before.end:
            return self.sign, self.is_clear, True
        return self._before.sign, self._before.is_clear, False

    def add(self, tick: Tick, track: SpeedTrack | None) -> list[tuple[Tick, float]]:
        """Take a tick; returns the ticks that met their speed (m/s, NaN where there is none)."""
        self._waiting.append(tick)
        key = None if track is None else (track.source, track.delay)
        if key != self._track_key:
            # Another source, or another latency: a change of velocity would be none.
            self._track_key = key
            self._try_anew()
        if track is not None:
            self._is_signed = track.is_signed
            self._slow = OWN.slow[track.source]
            self._is_rough = track.source is SpeedSource.FIXES
            self._span = OWN.spans[SpeedSource.VELOCITY if track.is_slow else track.source]
        met: list[tuple[Tick, float]] = []
        while self._waiting:
            first = self._waiting[0]
            is_late = tick.stamp - first.stamp > OWN.oldest
            if track is not None and not track.has_passed(first.stamp) and not is_late:
                break
            self._waiting.popleft()
            speed = None if track is None else track.at(first.stamp)
            self._meet(first, speed)
            met.append((first, math.nan if speed is None else speed * self.sign))
        return met

    def linear(self, stamp: float, force: Triple, frame: GyroFrame) -> Triple | None:
        """Return what to subtract from a specific force, m/s², body axes; None if it is not known.

        It does not come and go: a force that is corrected for moments only would mislead.
        """
        since, gravity = self._gravity or (math.inf, force)
        is_known = self.is_used and 0.0 <= stamp - since <= OWN.oldest
        if not is_known or frame.axes is None or stamp < self._pauses_until:
            if self._gives:
                self._pauses_until = stamp + OWN.oldest
            self._gives = False
            return None
        self._gives = True
        return minus(force, frame.to_body(gravity))

    @property
    def _turn(self) -> complex:
        """From the change of velocity, as if the IMU looked ahead, to the force."""
        return self.scale * cmath.exp(-1j * self.yaw)

    def _begin_trip(self, stamp: float, sign: float, is_clear: bool) -> None:
        self._before = _Trip(stamp, self.sign, self.is_clear)
        self.sign, self.is_clear = sign, is_clear
        taken = self._as_taken
        self._slope = taken.force - self._turn * taken.change
        self._product = self._energy = 0.0
        self._reversed = replace(taken)

    def _meet(self, tick: Tick, speed: float | None) -> None:
        if speed is None:
            self._matched.clear()
            self._gravity = None
            return
        is_slow = abs(speed) < OWN.standing
        if is_slow and self._is_under_way:
            self._begin_trip(tick.stamp, 1.0, False)
        elif not is_slow and self._span > 2 and abs(speed) < min(OWN.crawling, self._speed):
            # A speed that comes once a second may leave out that the vehicle stood, and mere fixes
            # smear a stop over seconds.
            self._begin_trip(tick.stamp, self.sign, self.is_clear and not self._is_rough)
        self._is_under_way, self._speed = not is_slow, abs(speed)
        self._matched.append((tick, speed * cmath.exp(1j * tick.yaw)))
        if len(self._matched) > self._span:
            self._weigh()

    def _weigh(self) -> None:
        """Take the change of velocity over the span off the mean force over it."""
        (begin, old), *others = list(self._matched)[-self._span - 1 :]
        end, new = others[-1]
        seconds = sum(tick.seconds for tick, _ in others)
        if not 0.5 * seconds < end.stamp - begin.stamp < 1.5 * seconds:
            return
        x, y, z = (
            sum(tick.force[axis] * tick.seconds for tick, _ in others) / seconds
            for axis in range(3)
        )
        # The speed of a receiver that stands wanders.
        stands = max(abs(new), abs(old)) < self._slow
        change = 0j if stands else (new - old) / seconds
        self._judge(complex(x, y), change, (abs(new) - abs(old)) / seconds)
        own = self.sign * change * self._turn
        self._gravity = (end.stamp, (x - own.real, y - own.imag, z))

    def _judge(self, force: complex, change: complex, along: float) -> None:
        """Look whether the speed explains the force of the last seconds, and with which sign."""
        self._tried += 1
        gain = max(1.0 / self._tried, 1.0 / OWN.watched)
        self._as_taken.add(force, self.sign * change, gain)
        self._reversed.add(force, -self.sign * change, gain)
        self._along += gain * (along**2 - self._along)
        self._changes += gain * (abs(change) ** 2 - self._changes)
        if not self._is_signed and self._is_under_way:
            self._decide(force, change * self._turn)
        without, quiet = self._as_taken.force_square, OWN.quiet**2
        limit = OWN.gain * without if without > quiet else quiet
        self.is_used = self._tried >= OWN.fewest and self._as_taken.square_left(self._turn) <= limit
        # On an even circle the gyro suffices: the speed of mere fixes would only add noise.
        if self._is_rough and not (
            self.is_yaw_usable and self._along >= OWN.along * self._changes > 0.0
        ):
            self.is_used = False

    def _decide(self, force: complex, forwards: complex) -> None:
        """Sum up, since the vehicle stood, what the force shows of the direction of travel.

        What the force is beside the vehicle's own acceleration is that before the trip: later it
        is known only by the sign that is sought.
        """
        self._product += ((force - self._slope) * forwards.conjugate()).real
        self._energy += abs(forwards) ** 2
        if not self.is_yaw_known or self._energy <= 0.0:
            return
        sigmas = self._product / (math.sqrt(OWN.correlated * self._energy) * self.noise)
        if sigmas * self.sign < -OWN.clear:
            self.sign = -self.sign
            self._as_taken, self._reversed = self._reversed, self._as_taken
        self.is_clear = self.is_clear or sigmas * self.sign > OWN.clear
