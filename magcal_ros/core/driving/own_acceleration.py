"""The vehicle's own acceleration, taken off the force: late by what the speed is late."""

from __future__ import annotations

import cmath
import math
from collections import deque
from typing import NamedTuple

from magcal_ros.core.driving.driving_tuning import DrivingTuning, SpeedSource
from magcal_ros.core.driving.gyro_frame import GyroFrame, Tick
from magcal_ros.core.driving.speedometer import SpeedTrack
from magcal_ros.core.geometry.vec3 import Triple


class _Matched(NamedTuple):
    """A tick with the velocity at its end, m/s in the frame, as if the IMU looked ahead."""

    tick: Tick
    velocity: complex


class _Tried(NamedTuple):
    """Force across up, and change of velocity if the IMU looked ahead, m/s².

    `pull` is the latter's part along the vehicle.
    """

    force: complex
    change: complex
    pull: float

    @property
    def backwards(self) -> _Tried:
        """The same of a vehicle that looks the other way."""
        return self._replace(change=-self.change)


class OwnAcceleration:
    """Frees the force of what the vehicle accelerates by.

    Over the last half second that the speed is known for, the mean force less the change of
    velocity is gravity, in the frame that the gyro keeps still; it is turned into the body axes
    of the moment. So neither a late speed nor one that comes once a second does harm.

    Parameters
    ----------
    tuning : DrivingTuning, optional
        What is taken for granted.

    Attributes
    ----------
    yaw : float
        Of the IMU in the vehicle, radians; zero until somebody knows better.
    scale : float
        Force over change of speed: the latter's noise makes it less than one.
    noise : float
        m/s² by which the force departs from what the speed explains.
    is_used : bool
        Whether the speed explains the force of the last seconds.
    unexplained : float
        Seconds for which it has not, while the force has changed.
    is_yaw_known : bool
        Whether somebody did: before, a vehicle is taken to drive forwards.
    sign : float
        Minus one while a speed without sign is that of a vehicle that backs up.
    sign_score : float
        Sigmas by which the force speaks for `sign` since the vehicle stood.
    """

    def __init__(self, tuning: DrivingTuning | None = None) -> None:
        self._tuning = tuning or DrivingTuning()
        self.yaw, self.is_yaw_known = 0.0, False
        self.scale, self.noise = 1.0, 0.3
        self._waiting: deque[Tick] = deque(maxlen=64)
        self._matched: deque[_Matched] = deque(maxlen=max(self._tuning.own.spans.values()) + 1)
        self._tried: deque[_Tried] = deque(maxlen=self._tuning.own.watched)
        self._gravity: tuple[float, Triple] | None = None
        self._is_rough, self._slow = False, self._tuning.own.slow[SpeedSource.ODOMETRY]
        self._is_signed, self._span = True, self._tuning.own.spans[SpeedSource.ODOMETRY]
        self.is_used, self.unexplained = False, 0.0
        self._stand()

    @property
    def stands(self) -> bool:
        """Whether the vehicle stood at the newest tick that met its speed."""
        return not self._of_trip

    def add(self, tick: Tick, track: SpeedTrack | None) -> list[tuple[Tick, float]]:
        """Take a tick; returns the ticks that met their speed (m/s, NaN where there is none)."""
        self._waiting.append(tick)
        met: list[tuple[Tick, float]] = []
        while self._waiting:
            first = self._waiting[0]
            is_late = tick.stamp - first.stamp > self._tuning.own.oldest
            if track is not None and not track.has_passed(first.stamp) and not is_late:
                break
            self._waiting.popleft()
            speed = None if track is None else track.at(first.stamp)
            if track is not None:
                self._is_signed = track.is_signed
                self._slow = self._tuning.own.slow[track.source]
                self._is_rough = track.source is SpeedSource.FIXES
                self._span = self._tuning.own.spans[track.source]
            self._meet(first, speed)
            met.append((first, math.nan if speed is None else speed * self.sign))
        return met

    def linear(self, stamp: float, force: Triple, frame: GyroFrame) -> Triple | None:
        """Return what to take off a specific force, m/s², body axes; None if it is not known."""
        if self._gravity is None or not self.is_used or frame.axes is None:
            return None
        since, gravity = self._gravity
        if not 0.0 <= stamp - since <= self._tuning.own.oldest:
            return None
        x, y, z = frame.to_body(gravity)
        return (force[0] - x, force[1] - y, force[2] - z)

    def restart(self) -> None:
        """Forget ticks: the gyro's frame is another one."""
        self._waiting.clear()
        self._matched.clear()
        self._tried.clear()
        self._gravity, self.is_used = None, False
        self._stand()

    def _stand(self) -> None:
        self.sign, self.sign_score = 1.0, 0.0
        self._product = self._energy = 0.0
        self._of_trip = 0

    def _meet(self, tick: Tick, speed: float | None) -> None:
        if speed is None:
            self._matched.clear()
            self._gravity = None
            return
        if abs(speed) < self._tuning.trip.standing:
            self._stand()
        velocity = speed * cmath.exp(1j * tick.yaw)
        self._matched.append(_Matched(tick, velocity))
        if len(self._matched) > self._span:
            self._weigh()

    @property
    def _turn(self) -> complex:
        """From the change of velocity, as if the IMU looked ahead, to the force."""
        return self.scale * cmath.exp(-1j * self.yaw)

    def _weigh(self) -> None:
        """Take the change of velocity over the span off the mean force over it."""
        first, *others = list(self._matched)[-self._span - 1 :]
        last = others[-1]
        seconds = sum(each.tick.seconds for each in others)
        if not 0.5 * seconds < last.tick.stamp - first.tick.stamp < 1.5 * seconds:
            return
        x, y, z = (
            sum(each.tick.force[axis] * each.tick.seconds for each in others) / seconds
            for axis in range(3)
        )
        # The speed of a receiver that stands wanders.
        stands = max(abs(last.velocity), abs(first.velocity)) < self._slow
        change = 0j if stands else (last.velocity - first.velocity) / seconds
        pull = (abs(last.velocity) - abs(first.velocity)) / seconds
        self._tried.append(_Tried(complex(x, y), self.sign * change, pull))
        self._of_trip += 1
        self._judge()
        own = self.sign * change * self._turn
        self._gravity = (last.tick.stamp, (x - own.real, y - own.imag, z))

    def _judge(self) -> None:
        """Look whether the speed explains the force of the last seconds, and with which sign."""
        own = self._tuning.own
        tried, count = self._tried, len(self._tried)
        self.is_used = False
        if count < own.fewest:
            return
        turn = self._turn
        mean = sum(each.force for each in tried) / count
        change = sum(each.change for each in tried) / count
        if not self._is_signed:
            self._decide(tried[-1], mean, change, turn)
        without = with_it = pulls = changes = 0.0
        for each in tried:
            force = each.force - mean
            left = force - (each.change - change) * turn
            without += abs(force) ** 2
            with_it += abs(left) ** 2
            pulls += each.pull**2
            changes += abs(each.change) ** 2
        quiet = count * own.quiet**2
        self.is_used = with_it <= (own.gain * without if without > quiet else quiet)
        # An even circle is seen through without: the speed of mere fixes would only add noise.
        if self._is_rough and pulls < own.pulling * changes:
            self.is_used = False
        if self.is_used:
            self.unexplained = 0.0
        elif without > 4.0 * quiet:
            self.unexplained += self._tuning.ticks.seconds

    def _decide(self, newest: _Tried, mean: complex, change: complex, turn: complex) -> None:
        """Sum up, since the vehicle stood, what the force says of the direction of travel."""
        trip = self._tuning.trip
        expected = (newest.change - change) * turn
        self._product += self.sign * ((newest.force - mean) * expected.conjugate()).real
        self._energy += abs(expected) ** 2
        spread = math.sqrt(trip.correlated * max(self._energy, 1e-9)) * self.noise
        score = self._product / spread
        if self.is_yaw_known and score * self.sign < -trip.clear:
            self.sign = -self.sign
            for index in range(
                len(self._tried) - min(self._of_trip, len(self._tried)), len(self._tried)
            ):
                self._tried[index] = self._tried[index].backwards
        self.sign_score = score * self.sign if self.is_yaw_known else 0.0
