"""Up carried by the gyro from message to message; the filter is asked once a block."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.triples import Triple, carried, distance, length, unit_triple
from magcal_ros.core.up.filter import (
    FLOOR,
    REST_LENGTH,
    REST_LENGTH_SIGMA,
    STEADY_PULL,
    UpFilter,
    pull_sigma,
)
from magcal_ros.core.up.gyro_check import GyroCheck
from magcal_ros.core.up.steady import AGREEING, LENGTH_FLOOR, SteadySpell

BLOCK = 0.04
"""Seconds of messages that the filter takes together."""
NOISE_MEMORY = 1.0
"""Seconds over which the accelerometer's noise is measured."""
STARTING_NOISE = 0.01
"""Accelerometer noise over gravity before it is measured."""
SMALLEST = 1e-3
"""Sigma of up, radians, that no filter takes away."""
KNOWN = 1.0
"""Seconds of a settled spell from which bias and length at rest are learnt."""
MOST_TURNING = 500
"""Messages of a turning robot over which its accelerometer's length is averaged."""
TURNING_SIGMA = 1e-3
"""How well that length, over gravity, is the length at rest."""
ZERO: Triple = (0.0, 0.0, 0.0)


class Block:
    """Sums over the messages since the filter was last asked."""

    def __init__(self) -> None:
        self.count = 0
        self.seconds = 0.0
        self.force = self.deviation = self.rate = self.turn = ZERO

    def add(self, force: Triple, up: Triple, rate: Triple, turn: Triple, seconds: float) -> None:
        """Take a message: force and carried up over gravity, rate, turn since the one before."""
        self.count += 1
        self.seconds += seconds
        a, b, c = force
        d, e, f = up
        x, y, z = self.force
        self.force = (x + a, y + b, z + c)
        x, y, z = self.deviation
        self.deviation = (x + a - d, y + b - e, z + c - f)
        x, y, z = self.rate
        self.rate = (x + rate[0], y + rate[1], z + rate[2])
        x, y, z = self.turn
        self.turn = (x + turn[0], y + turn[1], z + turn[2])

    def mean(self, total: Triple) -> Triple:
        """Return a sum over the number of messages."""
        return (total[0] / self.count, total[1] / self.count, total[2] / self.count)


class Carrier:
    """Carries up by the gyro and corrects it by the accelerometer as far as the motion allows.

    Attributes
    ----------
    up : tuple of float
        Up over gravity, body axes; its length is what the accelerometer reads at rest.
    bias : tuple of float
        The gyro's bias as far as it is known, rad/s.
    mean_rate : tuple of float
        Turn rate since the message before, less the bias, rad/s.
    variance : float
        Of up in either direction, rad².
    check : GyroCheck
        Whether the gyro is to be believed.
    """

    def __init__(self) -> None:
        self.up = self.bias = ZERO
        self.variance = math.inf
        self.check = GyroCheck()
        self._filter = UpFilter()
        self._noise = STARTING_NOISE**2
        self._rest, self._rest_sigma = REST_LENGTH, REST_LENGTH_SIGMA
        self._is_rest_seen = False
        self._turning = 0
        self.begin((0.0, 0.0, 1.0), ZERO)

    def begin(self, force: Triple, rate: Triple) -> None:
        """Start anew from a force over gravity; the gyro's bias is still known."""
        self._force, self._rate = force, rate
        self.mean_rate = ZERO
        self._block = Block()
        self._spell = SteadySpell()
        self._is_settled = False
        self.check.restart()
        self.up = force
        sigma = pull_sigma(length(rate))
        self._filter.begin(np.array(force), self._noise, sigma)
        self._take_over()

    @property
    def rate(self) -> Triple:
        """The newest turn rate less the bias, rad/s."""
        (x, y, z), (p, q, r) = self._rate, self.bias
        return (x - p, y - q, z - r)

    def add(self, force: Triple, rate: Triple, seconds: float) -> None:
        """Take force (over gravity) and rate so many seconds after the ones before."""
        before, old = self._rate, self._force
        self._rate, self._force = rate, force
        p, q, r = self.bias
        mean = (
            0.5 * (rate[0] + before[0]) - p,
            0.5 * (rate[1] + before[1]) - q,
            0.5 * (rate[2] + before[2]) - r,
        )
        self.mean_rate = mean
        turn = (mean[0] * seconds, mean[1] * seconds, mean[2] * seconds)
        self.up = carried(self.up, turn)
        self._block.add(force, self.up, rate, turn, seconds)
        # Half the square of a difference is the noise; a jump is none.
        square = min(distance(force, old) ** 2 / 6.0, 10.0 * self._noise + SMALLEST**2)
        self._noise += min(1.0, seconds / NOISE_MEMORY) * (square - self._noise)
        if self._block.seconds >= BLOCK:
            block, self._block = self._block, Block()
            self._end(block)

    def _end(self, block: Block) -> None:
        """Let the filter correct up by what the block brought."""
        force, rate = block.mean(block.force), block.mean(block.rate)
        following, noise = self._filter, math.sqrt(self._noise)
        self.check.add(force, block.turn, block.seconds)
        sigma = STEADY_PULL if self._is_settled else pull_sigma(length(rate))
        following.predict(np.array(self.up), np.array(block.turn), block.seconds, sigma)
        goes_on = self._spell.add(force, rate, noise, block.count, block.seconds)
        if self._is_settled and not goes_on:
            self._is_settled = False
            following.forget_pull(pull_sigma(length(rate)))
        following.observe_force(np.array(block.mean(block.deviation)), self._noise / block.count)
        if self._is_rest_seen:
            # Where up is uncertain, its length along the estimate is, to second order, as well.
            doubt = following.tilt_variance
            following.observe_length(self._rest, self._rest_sigma**2 + doubt**2)
        if not self._is_settled:
            self._settle(noise)
        elif self._spell.seconds > KNOWN:
            following.observe_bias(np.array(rate))
            self._rest = length(self._spell.force)
            self._rest_sigma = math.hypot(LENGTH_FLOOR, noise / math.sqrt(self._spell.count))
            self._is_rest_seen = True
        if not self._is_rest_seen and not self._spell.count:
            self._guess_rest(force, noise, block.count)
        self._take_over()

    def _guess_rest(self, force: Triple, noise: float, count: int) -> None:
        """Until the robot was seen at rest, take its length while it turns for that at rest."""
        self._turning = min(self._turning + count, MOST_TURNING)
        self._rest += count / self._turning * (length(force) - self._rest)
        self._rest_sigma = math.hypot(TURNING_SIGMA, noise / math.sqrt(self._turning))

    def _settle(self, noise: float) -> None:
        """Believe the accelerometer once it is steady for long enough, or its length speaks."""
        spell, following = self._spell, self._filter
        up: Triple = tuple(following.up.tolist())
        if not spell.shows_up(up, self._rest, self._rest_sigma, noise):
            return
        self._is_settled = True
        # A jump that the gyro did not see may still be a long, even acceleration.
        is_doubtful = spell.seconds >= AGREEING
        jump = distance(unit_triple(spell.force), unit_triple(up)) if is_doubtful else 0.0
        variance = self._noise / spell.count + FLOOR**2
        following.begin(np.array(spell.force), variance, math.hypot(STEADY_PULL, jump))

    def _take_over(self) -> None:
        x, y, z, p, q, r = self._filter.state[:6].tolist()
        self.up, self.bias = (x, y, z), (p, q, r)
        self.variance = self._filter.tilt_variance + SMALLEST**2
