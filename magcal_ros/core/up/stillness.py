"""Whether a robot rests or turns, and whether its gyro can be used.

Gyro and accelerometer cannot separate a slow, steady circle from a rest with a gyro bias about up.
The raw field, calibrated or not, separates them: it rotates with the robot.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.slope import Slope
from magcal_ros.core.geometry.vec3 import (
    Triple,
    cross,
    distance,
    dot,
    interpolate,
    length,
    minus,
    plus,
    scaled,
)
from magcal_ros.core.knowledge import CLEAR
from magcal_ros.core.samples.samples_tuning import BIAS_AT_REST, STREAMS
from magcal_ros.core.samples.window import NOISELESS
from magcal_ros.core.up.filter import CHECK, FILTER, REST


class FieldStillness:
    """Compares the present field with that at the beginning of an interval.

    `mean` is the present field, averaged over some tenths of a second.
    """

    def __init__(self) -> None:
        self._stamp = -math.inf
        self._last = self.mean = ZERO
        self._noise = 0.0
        self.begin()

    def begin(self) -> None:
        """Start a new interval with the next field sample."""
        self._first, self._first_count, self._since = ZERO, 0, math.inf

    def add(self, stamp: float, field: Triple) -> None:
        """Add a raw field sample (any unit) at a stamp in seconds."""
        seconds = stamp - self._stamp
        self._stamp = stamp
        if not 0.0 < seconds < STREAMS.longest_field_gap:
            self.mean, self._noise = field, 0.0
            self.begin()
        else:
            share = min(1.0, seconds / REST.field_mean)
            self.mean = interpolate(self.mean, field, share)
            # Half the square of a difference is the noise.
            square = distance(field, self._last) ** 2 / 6.0
            self._noise += 0.2 * share * (square - self._noise)
        self._last = field
        if not self._first_count:
            self._since = stamp
        if stamp - self._since < REST.field_mean:
            self._first_count += 1
            self._first = interpolate(self._first, field, 1.0 / self._first_count)

    def is_recent(self, stamp: float) -> bool:
        """Whether a field sample came shortly before a stamp."""
        return abs(stamp - self._stamp) < STREAMS.longest_field_gap

    def has_turned(self, rate: float) -> bool | None:
        """Whether the robot really turns at a rate; None while the field is inconclusive.

        `rate` is the gyro's rate about up beyond its known bias, rad/s.
        """
        seconds = self._stamp - self._since
        if not seconds > 2.0 * REST.field_mean:
            return None
        bound = REST.level_share * length(self._last) * min(1.0, abs(rate) * seconds)
        change = distance(self.mean, self._first)
        noise = CLEAR * math.sqrt(2.0 * self._noise / self._first_count)
        if change + noise < bound:
            return False
        return True if change - noise > bound else None


ZERO: Triple = (0.0, 0.0, 0.0)


class BlockMeans(NamedTuple):
    """Means over a block of messages: force (g), rate (rad/s); how many, over how many seconds."""

    force: Triple
    rate: Triple
    messages: int
    seconds: float


class SteadyInterval:
    """Detects an interval of blocks in which force and rate are constant.

    `sway` and `shake` are the variances per axis of the rates, (rad/s)², and forces, g².
    """

    def __init__(self) -> None:
        self.seconds = self.sway = self.shake = 0.0
        self.count = 0  # messages
        self.force = self.rate = ZERO

    def add(self, block: BlockMeans, noise: float, rate_noise: float) -> bool:
        """Add a block; return whether it continues the interval.

        `noise` and `rate_noise` are the sigmas of one message per axis, g and rad/s.
        """
        force, rate, count, seconds = block
        if self.count:
            alike = REST.alike * math.sqrt(3.0 / count + 3.0 / self.count)
            if (
                distance(force, self.force) < REST.loose + alike * noise
                and distance(rate, self.rate) < REST.loose_rate + alike * rate_noise
            ):
                self.count += count
                share = count / self.count
                third = (1.0 - share) / 3.0
                self.sway += share * (third * distance(rate, self.rate) ** 2 - self.sway)
                self.shake += share * (third * distance(force, self.force) ** 2 - self.shake)
                self.force = interpolate(self.force, force, share)
                self.rate = interpolate(self.rate, rate, share)
                self.seconds += seconds
                return True
        self.seconds, self.count, self.force, self.rate = seconds, count, force, rate
        self.sway = self.shake = 0.0
        return False

    def evidence(
        self,
        up: Triple,
        tilt_variance: float,
        length_at_rest: tuple[float, float],
        noise: float,
    ) -> float:
        """Return the log likelihood ratio of a force that points up, against an acceleration.

        Direction and length of the mean force tell both apart. `up` (g) is the propagated one, with
        the variance of its direction, rad². `length_at_rest` is that of the accelerometer and its
        sigma, g, and `noise` the sigma of one message's force per axis.
        """
        size, up_size = length(self.force), length(up)
        if size <= 0.0 or up_size <= 0.0:
            return -math.inf
        white = noise * noise / self.count
        across, along = tilt_variance + white, length_at_rest[1] ** 2 + white
        jump = distance(scaled(self.force, 1.0 / size), scaled(up, 1.0 / up_size)) ** 2
        # By the jump of its direction, an acceleration is normal, and its square lengthens a force.
        acceleration = FILTER.usual_acceleration**2
        moving = across + acceleration
        share = acceleration / moving
        square, spread = share * share * jump, share * across
        excess, longer = size - length_at_rest[0], 0.5 * square + spread
        loose = along + square * spread + spread * spread
        # A bump changes the length, too: it excludes an acceleration by no more than five sigmas.
        off = min((excess - longer) ** 2 / loose, 25.0)
        odds = 0.5 * (math.log(loose / along) + off - excess**2 / along)
        # Student distributions of two degrees of freedom: up may be wrong by more than its sigma.
        odds += math.log(moving / across)
        return odds + 2.0 * math.log((1.0 + 0.5 * jump / moving) / (1.0 + 0.5 * jump / across))


class ShakenRest:
    """Averages blocks, and gives the gyro's bias if the means are constant for some seconds."""

    def __init__(self) -> None:
        self._means: deque[FloatArray] = deque(maxlen=BIAS_AT_REST.at_least)
        self._begin()

    def _begin(self) -> None:
        self._seconds = 0.0
        self._blocks: list[tuple[Triple, Triple, Triple]] = []

    def forget(self) -> None:
        """Start again: the field is missing, or time has jumped."""
        self._means.clear()
        self._begin()

    def add(self, block: BlockMeans, field: Triple) -> tuple[FloatArray, FloatArray, float] | None:
        """Add a block and the raw field at its end, in any unit.

        Returns mean force (3,), g, and rate (3,), rad/s, with its variance per axis; None if no
        rest is detected.
        """
        self._seconds += block.seconds
        self._blocks.append((block.force, block.rate, field))
        if self._seconds < 1.0:
            return None
        self._means.append(np.mean(self._blocks, axis=0))
        self._begin()
        each = np.array(self._means)
        mean = each.mean(axis=0)
        gaps = np.linalg.norm(each - mean, axis=2)
        field_bound = REST.shaken_field * np.linalg.norm(mean[2])
        most = (REST.shaken_force, BIAS_AT_REST.loose_rate, field_bound)
        if len(each) < BIAS_AT_REST.at_least or (gaps > most).any():
            return None
        # The next estimate uses other seconds.
        self._means.clear()
        scatter = float(np.sum(gaps[:, 1] ** 2)) / (3.0 * (BIAS_AT_REST.at_least - 1))
        variance = REST.shaken_sigma**2 + scatter / BIAS_AT_REST.at_least
        return mean[0], mean[1], variance


class GyroCheck:
    """Compares changes of the specific force with those predicted by the gyro.

    While the turn is within the gyro's noise, both are averaged over spans that are longer than the
    shaking of an engine: its rates and accelerations are unrelated to a turn.
    """

    def __init__(self) -> None:
        self.is_consistent = True
        self._slope, self._noise = Slope(CHECK.memory), 0.0
        self.restart()

    def restart(self) -> None:
        """Start again, without a comparison with earlier blocks."""
        self._before: tuple[Triple, Triple] | None = None
        self._begin()

    def _begin(self) -> None:
        self._force = self._turn = ZERO
        self._seconds = self._variance = 0.0

    def add(self, force: Triple, turn: Triple, seconds: float, variance: float = 0.0) -> None:
        """Add a block of messages.

        `force` is the mean of the block, g, `turn` its rotation vector, radians, and `variance` the
        variance of each component of `turn` by the gyro's noise, rad².
        """
        self._force = plus(self._force, scaled(force, seconds))
        self._turn = plus(self._turn, turn)
        self._seconds += seconds
        self._variance += variance
        # A turn clearly beyond the gyro's noise is compared at once.
        clear = CLEAR**2 * self._variance
        if self._seconds < CHECK.span and dot(self._turn, self._turn) <= clear:
            return
        mean, before = scaled(self._force, 1.0 / self._seconds), self._before
        self._before = mean, self._turn
        if before is not None:
            # A direction fixed in the world changes in the body by u x w dt.
            expected = cross(before[0], interpolate(before[1], self._turn, 0.5))
            seen = minus(mean, before[0])
            squares = dot(expected, expected), dot(seen, seen)
            self._slope.add(dot(expected, seen), *squares, self._seconds, 3.0)
            # The noise across the force, in the mean of two turns.
            keeps = math.exp(-self._seconds / CHECK.memory)
            self._noise = keeps * self._noise + self._variance
            if self._slope.predicted > CHECK.enough**2 + CHECK.clear_noise * self._noise:
                least, most = self._slope.bounds(CLEAR)
                # The slope of a correct gyro is one, of a mirrored one minus one.
                if most < 0.0 or least > 0.0:
                    self.is_consistent = most > 0.0
        self._begin()


class GyroAxes:
    """Follows when the axes of a gyro change, and detects those that never do.

    Such dead axes hide tilting. Two axes of a simulated gyro without noise may rightly be constant.
    `changed` are the stamps of the newest change of each axis, seconds; the first rates are a
    change from zero.
    """

    def __init__(self) -> None:
        self.changed = [-math.inf] * 3
        self._last: list[Triple] = []
        self._has_changed = [False, False, False]
        self._noisy = 0

    @property
    def are_dead(self) -> bool:
        """Whether an axis has never changed; false until another axis has shown noise."""
        return self._noisy >= CHECK.dead and not all(self._has_changed)

    def rate_about_up(self, rate: Triple, up: Triple) -> Triple | None:
        """Return the rate of a turn about up, rad/s, that working axes show as `rate`.

        `up` is in body axes, of any length. None if no working axis is near up.
        """
        x, y, z = (own if works else 0.0 for own, works in zip(up, self._has_changed, strict=True))
        working = x, y, z
        square = dot(working, working)
        if square < CHECK.near_up**2 * dot(up, up):
            return None
        return scaled(up, dot(rate, working) / square)

    def add(self, stamp: float, rate: Triple) -> None:
        """Take the next rate, rad/s."""
        last = self._last[-1] if self._last else ZERO
        new = [k for k in range(3) if rate[k] != last[k]]
        for axis in new:
            self.changed[axis] = stamp
        if len(self._last) == 2 and not all(self._has_changed):
            before = self._last[0]
            bends = [abs(rate[k] - 2.0 * last[k] + before[k]) for k in range(3)]
            self._has_changed = [a or k in new for k, a in enumerate(self._has_changed)]
            self._noisy += max(bends) > NOISELESS * max(map(abs, rate))
        self._last = [*self._last[-1:], rate]
