"""The vehicle's own acceleration, subtracted from the specific force at the speed's delay."""

from __future__ import annotations

import cmath
import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magcal_ros.core.driving.chords import GyroFrame, Tick
from magcal_ros.core.driving.driving_tuning import OWN, TRIP, SpeedSource
from magcal_ros.core.driving.mounting_yaw import ComplexArray
from magcal_ros.core.driving.speedometer import SpeedTrack
from magcal_ros.core.geometry.vec3 import Triple, minus


class Tried(NamedTuple):
    """Force across up, and change of velocity if the IMU looked ahead, m/s².

    `along` is the latter's part along the vehicle.
    """

    force: complex
    change: complex
    along: float


class SpeedTrial:
    """The newest forces and changes of velocity, and how they scatter."""

    def __init__(self) -> None:
        self._tried: deque[Tried] = deque(maxlen=OWN.watched)

    def __len__(self) -> int:
        return len(self._tried)

    def clear(self) -> None:
        """Forget them."""
        self._tried.clear()

    def add(self, tried: Tried) -> None:
        """Take the newest, and leave the oldest."""
        self._tried.append(tried)

    def turn_back(self, count: int) -> None:
        """Negate the newest changes, as many as `count`: the vehicle has backed up."""
        for index in range(max(0, len(self._tried) - count), len(self._tried)):
            tried = self._tried[index]
            self._tried[index] = tried._replace(change=-tried.change)

    @property
    def last(self) -> Tried:
        """The newest as it was added."""
        return self._tried[-1]

    def left(self, turn: complex) -> complex:
        """Return the mean of the force less `turn` times the change; zero before the first."""
        return complex(np.mean(self._left(turn))) if self._tried else 0j

    @property
    def newest(self) -> Tried:
        """The newest, less the means."""
        force, change, _ = np.mean(np.array(self._tried), axis=0)
        last = self._tried[-1]
        return last._replace(force=last.force - force, change=last.change - change)

    @property
    def share_along(self) -> float:
        """Share of the changes that lies along the vehicle: starts and stops."""
        _, changes, along = np.sum(np.abs(np.array(self._tried)) ** 2, axis=0)
        return float(along / changes) if changes > 0.0 else 0.0

    def scatter(self, turn: complex) -> float:
        """Return the variance of the force less `turn` times the change, (m/s²)²."""
        return float(np.var(self._left(turn)))

    def _left(self, turn: complex) -> ComplexArray:
        force, change, _ = np.array(self._tried).T
        return np.asarray(force - turn * change)


class _Matched(NamedTuple):
    """A tick with the velocity at its end, m/s in the frame, as if the IMU looked ahead."""

    tick: Tick
    velocity: complex


class _Trip(NamedTuple):
    """When a trip ended, which way it went, and whether the force had decided on that."""

    end: float = -math.inf
    sign: float = 1.0
    is_clear: bool = False


@dataclass
class _Evidence:
    """What the force shows of the direction of travel since a stamp; positive is forwards.

    `slope` is what the force was then beside the vehicle's own acceleration.
    """

    since: float
    slope: complex = 0j
    product: float = 0.0
    energy: float = 0.0
    count: int = 0

    def add(self, force: complex, expected: complex) -> None:
        self.product += (force * expected.conjugate()).real
        self.energy += abs(expected) ** 2
        self.count += 1

    def score(self, noise: float, correlated: float) -> float:
        """Return it in sigmas."""
        return self.product / (math.sqrt(correlated * max(self.energy, 1e-9)) * noise)


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
    that of a vehicle that backs up, and `sign_score` are the sigmas by which the force supports it
    since the vehicle stood.
    """

    def __init__(self) -> None:
        self.yaw, self.is_yaw_usable, self.is_yaw_known = 0.0, False, False
        self.scale, self.noise = 1.0, 0.3
        self._waiting: deque[Tick] = deque(maxlen=64)
        self._matched: deque[_Matched] = deque(maxlen=max(OWN.spans.values()) + 1)
        self._trial = SpeedTrial()
        self._trip = SpeedTrial()
        self._before, self._is_under_way, self._speed = _Trip(), True, 0.0
        self._gravity: tuple[float, Triple] | None = None
        self._is_rough, self._slow = False, OWN.slow[SpeedSource.ODOMETRY]
        self._is_signed, self._span = True, OWN.spans[SpeedSource.ODOMETRY]
        self._gives, self._pauses_until = False, -math.inf
        self._track_key: tuple[SpeedSource, float] | None = None
        self.is_used = False
        self._stand(-math.inf)

    @property
    def is_clear(self) -> bool:
        """Whether the force has decided on the direction of travel since the vehicle stood."""
        return self.sign_score > TRIP.clear

    def trip_at(self, stamp: float) -> tuple[float, bool, bool]:
        """Return the sign of a trip under way at a stamp, or that ended after it.

        And whether the force has decided on it, and whether it may still do so.
        """
        is_open = stamp > self._before.end
        sign, is_clear = (self.sign, self.is_clear) if is_open else self._before[1:]
        return sign, is_clear, is_open

    def add(self, tick: Tick, track: SpeedTrack | None) -> list[tuple[Tick, float]]:
        """Take a tick; returns the ticks that met their speed (m/s, NaN where there is none)."""
        self._waiting.append(tick)
        key = None if track is None else (track.source, track.delay)
        if key != self._track_key:
            # Another source, or another latency: a change of velocity would be none.
            self._track_key = key
            self._matched.clear()
            self._trial.clear()
            self.is_used = False
        met: list[tuple[Tick, float]] = []
        while self._waiting:
            first = self._waiting[0]
            is_late = tick.stamp - first.stamp > OWN.oldest
            if track is not None and not track.has_passed(first.stamp) and not is_late:
                break
            self._waiting.popleft()
            speed = None if track is None else track.at(first.stamp)
            if track is not None:
                self._is_signed = track.is_signed
                like = SpeedSource.VELOCITY if track.is_slow else track.source
                self._slow = OWN.slow[track.source]
                self._is_rough = track.source is SpeedSource.FIXES
                self._span = OWN.spans[like]
            self._meet(first, speed)
            met.append((first, math.nan if speed is None else speed * self.sign))
        return met

    def linear(self, stamp: float, force: Triple, frame: GyroFrame) -> Triple | None:
        """Return what to subtract from a specific force, m/s², body axes; None if it is not known.

        It does not come and go: a force that is corrected for moments only would mislead.
        """
        gravity = self._gravity_at(stamp)
        if gravity is None or frame.axes is None or stamp < self._pauses_until:
            if self._gives:
                self._pauses_until = stamp + OWN.oldest
            self._gives = False
            return None
        self._gives = True
        return minus(force, frame.to_body(gravity))

    def _gravity_at(self, stamp: float) -> Triple | None:
        """Return gravity in the gyro's frame, m/s², while it may be used."""
        if self._gravity is None or not self.is_used:
            return None
        since, gravity = self._gravity
        return gravity if 0.0 <= stamp - since <= OWN.oldest else None

    def restart(self) -> None:
        """Forget ticks: the gyro's frame is another one."""
        self._waiting.clear()
        self._matched.clear()
        self._trial.clear()
        self._gravity, self.is_used = None, False
        self._gives, self._pauses_until = False, -math.inf
        self._before = _Trip()
        self._stand(-math.inf)

    def _stand(self, stamp: float) -> None:
        self.sign, self.sign_score = 1.0, 0.0
        self._whole, self._newer = _Evidence(stamp), _Evidence(stamp)
        self._trip.clear()

    def _meet(self, tick: Tick, speed: float | None) -> None:
        if speed is None:
            self._matched.clear()
            self._gravity = None
            return
        is_slow = abs(speed) < TRIP.standing
        if is_slow and self._is_under_way:
            self._before = _Trip(tick.stamp, self.sign, self.is_clear)
            self._stand(tick.stamp)
        self._is_under_way = not is_slow
        if abs(speed) < min(TRIP.crawling, self._speed):
            # A speed that comes once a second may leave out that the vehicle stood.
            self._newer = _Evidence(tick.stamp, self._trial.left(self._turn))
        self._speed = abs(speed)
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
        along = (abs(last.velocity) - abs(first.velocity)) / seconds
        self._trial.add(Tried(complex(x, y), self.sign * change, along))
        # Standing is where the force of the trip that follows is counted from, whichever its sign.
        self._trip.add(Tried(complex(x, y), change if self._is_under_way else 0j, along))
        self._judge()
        own = self.sign * change * self._turn
        self._gravity = (last.tick.stamp, (x - own.real, y - own.imag, z))

    def _judge(self) -> None:
        """Look whether the speed explains the force of the last seconds, and with which sign."""
        trial = self._trial
        self.is_used = False
        if len(trial) < OWN.fewest:
            return
        if not self._is_signed:
            self._decide()
        without, with_it = trial.scatter(0j), trial.scatter(self._turn)
        quiet, gain = OWN.quiet**2, OWN.rough_gain if self._is_rough else OWN.gain
        self.is_used = with_it <= (gain * without if without > quiet else quiet)
        # On an even circle the gyro suffices: the speed of mere fixes would only add noise.
        if self._is_rough and (trial.share_along < OWN.along or not self.is_yaw_usable):
            self.is_used = False

    def _decide(self) -> None:
        """Sum up, since the vehicle stood, what the force shows of the direction of travel.

        Earlier trips have no part in the means that are taken off: they may have another sign.
        """
        if not self._is_under_way:
            return
        newest, last = self._trip.newest, self._trip.last
        self._whole.add(newest.force, newest.change * self._turn)
        # Where the sign may have changed meanwhile, a mean over both parts would be of neither.
        self._newer.add(last.force - self._newer.slope, last.change * self._turn)
        if not self.is_yaw_known:
            return
        whole, newer = (
            each.score(self.noise, TRIP.correlated) for each in (self._whole, self._newer)
        )
        if newer * self.sign < -TRIP.clear < whole * self.sign:
            self._before = _Trip(self._newer.since, self.sign, self.is_clear)
            self._whole, whole = self._newer, newer
        if whole * self.sign < -TRIP.clear:
            self.sign = -self.sign
            self._trial.turn_back(self._whole.count)
        # Mere fixes smear a stop over seconds: what was known before it is known no longer.
        least = min(whole * self.sign, newer * self.sign)
        self.sign_score = least if self._is_rough else whole * self.sign
