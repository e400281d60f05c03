"""When the accelerometer may be believed: the robot stands, or rolls on without a change.

A robot that neither turns nor changes its acceleration for a while is not pulled. That could also
be a steady acceleration, but none lasts. Earlier than by its duration a tilt is told from a pull
by the accelerometer's length, which a pull stretches and a tilt does not.
"""

from __future__ import annotations

import math

from magcal_ros.core.triples import Triple, between, distance, dot, length

LARGEST_RATE = 0.035
"""rad/s. A steady gyro that reads more than this is turning; less may be its bias."""
LASTING = 4.0
"""Seconds of steadiness after which there is no pull, although the length speaks for one."""
UNDECIDED = 1.0
"""The same where the length says nothing."""
AGREEING = 0.5
"""The same where moreover the accelerometer points to where up was carried."""
AGREES = 0.01
"""Radians between the two."""
SHORTEST = 0.1
"""The same where the length speaks against a pull."""
LOOSE = 0.005
"""Change of the acceleration over gravity that is still called steady, beside the noise."""
CLEAR = 3.0
"""Sigmas."""
LENGTH_FLOOR = 3e-4
"""How well a length over gravity is known at best."""


class SteadySpell:
    """Watches blocks of messages for a spell in which nothing changes.

    Attributes
    ----------
    seconds : float
        How long the spell has lasted; zero when there is none.
    force : tuple of float
        Mean accelerometer reading of the spell, over gravity, body axes.
    count : int
        Messages in it.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self.count = 0
        self.force: Triple = (0.0, 0.0, 0.0)

    def add(self, force: Triple, rate: Triple, noise: float, count: int, seconds: float) -> bool:
        """Take the next block; returns whether it goes on as the spell did.

        Parameters
        ----------
        force, rate : tuple of float
            Means over the block, over gravity and rad/s.
        noise : float
            Sigma of one message's force per axis, over gravity.
        count : int
            Messages in the block.
        seconds : float
            How long it took.
        """
        if length(rate) > LARGEST_RATE:
            self.seconds, self.count = 0.0, 0
            return False
        if self.count:
            expected = noise * math.sqrt(3.0 / count + 3.0 / self.count)
            if distance(force, self.force) < LOOSE + CLEAR * expected:
                self.count += count
                self.force = between(self.force, force, count / self.count)
                self.seconds += seconds
                return True
        self.seconds, self.count, self.force = seconds, count, force
        return False

    def shows_up(self, up: Triple, rest: float, rest_sigma: float, noise: float) -> bool:
        """Whether the mean force of the spell points up.

        Parameters
        ----------
        up : tuple of float
            Up as carried, over gravity.
        rest, rest_sigma : float
            What the accelerometer reads at rest, over gravity, and how well that is known.
        noise : float
            Sigma of one message's force per axis, over gravity.
        """
        size, up_size = length(self.force), length(up)
        if self.seconds >= LASTING or not self.count or size <= 0.0 or up_size <= 0.0:
            return self.seconds >= LASTING
        cosine = min(1.0, dot(self.force, up) / (size * up_size))
        stretch = rest / max(cosine, 0.1) - rest
        excess = size - rest
        clear = CLEAR * math.sqrt(LENGTH_FLOOR**2 + rest_sigma**2 + noise**2 / self.count)
        if stretch - excess > abs(excess) + clear:
            return self.seconds >= SHORTEST
        if excess > 0.5 * stretch + 0.5 * clear:
            return False
        return self.seconds >= (AGREEING if cosine > math.cos(AGREES) else UNDECIDED)
