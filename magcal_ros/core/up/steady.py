"""When the accelerometer may be believed: the robot stands, or rolls on without a change.

A robot whose turn rate and specific force do not change for a while is not accelerated. How large
the rate is tells nothing: a gyro at rest reads its bias. A steady acceleration does not last.
Earlier than by its duration a tilt is told from an acceleration by the accelerometer's length,
which an acceleration stretches and a tilt does not.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from magcal_ros.core.geometry.vec3 import Triple, between, distance, dot, length
from magcal_ros.core.up.up_tuning import RestTuning

ZERO: Triple = (0.0, 0.0, 0.0)


class BlockMeans(NamedTuple):
    """Means over a block of messages: force (g), rate (rad/s); how many, over how many seconds."""

    force: Triple
    rate: Triple
    messages: int
    seconds: float


class SteadySpell:
    """Watches blocks of messages for a spell in which nothing changes.

    Parameters
    ----------
    tuning : RestTuning
        What is taken for granted.

    Attributes
    ----------
    seconds : float
        How long the spell has lasted; zero when there is none.
    force : tuple of float
        Mean accelerometer reading of the spell, g, body axes.
    rate : tuple of float
        Mean gyro reading of the spell, rad/s.
    count : int
        Messages in it.
    sway, pull : float
        Variance per axis of the blocks' rates and forces about their means, (rad/s)² and g².
    """

    def __init__(self, tuning: RestTuning | None = None) -> None:
        self.tuning = tuning or RestTuning()
        self.end()

    def end(self) -> None:
        """Forget the spell: it is over."""
        self.seconds = self.sway = self.pull = 0.0
        self.count = 0
        self.force = self.rate = ZERO

    def add(self, block: BlockMeans, noise: float, rate_noise: float) -> bool:
        """Take the next block; returns whether it goes on as the spell did.

        Parameters
        ----------
        block : BlockMeans
            Means over the block.
        noise, rate_noise : float
            Sigma of one message per axis, g and rad/s.
        """
        force, rate, count, seconds = block
        if self.count:
            alike = self.tuning.alike * math.sqrt(3.0 / count + 3.0 / self.count)
            if (
                distance(force, self.force) < self.tuning.loose + alike * noise
                and distance(rate, self.rate) < self.tuning.loose_rate + alike * rate_noise
            ):
                self.count += count
                share = count / self.count
                third = (1.0 - share) / 3.0
                self.sway += share * (third * distance(rate, self.rate) ** 2 - self.sway)
                self.pull += share * (third * distance(force, self.force) ** 2 - self.pull)
                self.force = between(self.force, force, share)
                self.rate = between(self.rate, rate, share)
                self.seconds += seconds
                return True
        self.seconds, self.count, self.force, self.rate = seconds, count, force, rate
        self.sway = self.pull = 0.0
        return False

    def shows_up(self, up: Triple, rest: float, rest_sigma: float, noise: float) -> bool:
        """Whether the mean force of the spell points up.

        Parameters
        ----------
        up : tuple of float
            Up as propagated, g.
        rest, rest_sigma : float
            What the accelerometer reads at rest, over gravity, and how well that is known.
        noise : float
            Sigma of one message's force per axis, over gravity.
        """
        size, up_size = length(self.force), length(up)
        if self.seconds >= self.tuning.lasting or not self.count or size <= 0.0 or up_size <= 0.0:
            return self.seconds >= self.tuning.lasting
        cosine = min(1.0, dot(self.force, up) / (size * up_size))
        stretch = rest / max(cosine, 0.1) - rest
        excess = size - rest
        clear = self.tuning.clear * math.sqrt(
            self.tuning.length_floor**2 + rest_sigma**2 + noise**2 / self.count
        )
        if stretch - excess > abs(excess) + clear:
            return self.seconds >= self.tuning.shortest
        if excess > 0.5 * stretch + 0.5 * clear:
            return False
        return self.seconds >= (
            self.tuning.agreeing if cosine > math.cos(self.tuning.agrees) else self.tuning.undecided
        )
