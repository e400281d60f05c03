"""Whether gyro and accelerometer agree; a mirrored gyro must not propagate up."""

from __future__ import annotations

import math

from magcal_ros.core.geometry.vec3 import Triple, cross, dot
from magcal_ros.core.up.up_tuning import GyroCheckTuning

ZERO: Triple = (0.0, 0.0, 0.0)


class GyroCheck:
    """Compares how the specific force changes with how the gyro says it should.

    Where the gyro's turn is not clear of its noise both are averaged over spans that are long
    beside the shaking of an engine, whose rates and accelerations have nothing to do with a turn.
    """

    def __init__(self, tuning: GyroCheckTuning | None = None) -> None:
        self._tuning = tuning or GyroCheckTuning()
        self.is_believed = True
        self._together = self._said = self._seen = self._count = self._noise = 0.0
        self.restart()

    def restart(self) -> None:
        """Do not compare what comes next with what came before."""
        self._before: tuple[Triple, Triple] | None = None
        self._begin()

    def _begin(self) -> None:
        self._force = self._turn = ZERO
        self._seconds = self._variance = 0.0

    def add(self, force: Triple, turn: Triple, seconds: float, variance: float = 0.0) -> None:
        """Take a block of messages.

        Parameters
        ----------
        force : tuple of float
            Mean over the block, g.
        turn : tuple of float
            Rotation vector over it, radians.
        seconds : float
            Its length.
        variance : float
            Of each part of `turn`, by the gyro's noise, rad².
        """
        x, y, z = self._force
        self._force = (x + seconds * force[0], y + seconds * force[1], z + seconds * force[2])
        x, y, z = self._turn
        self._turn = (x + turn[0], y + turn[1], z + turn[2])
        self._seconds += seconds
        self._variance += variance
        clear = self._tuning.clear_turn**2 * self._variance
        if self._seconds < self._tuning.span and dot(self._turn, self._turn) <= clear:
            return
        lasted = self._seconds
        x, y, z = self._force
        mean, before = (x / lasted, y / lasted, z / lasted), self._before
        self._before = mean, self._turn
        if before is not None:
            self._compare(*before, mean, lasted)
        self._begin()

    def _compare(self, old: Triple, old_turn: Triple, new: Triple, seconds: float) -> None:
        """Compare how the mean force changed from span to span with what the gyro makes of it."""
        turn = self._turn
        middle = (
            0.5 * (turn[0] + old_turn[0]),
            0.5 * (turn[1] + old_turn[1]),
            0.5 * (turn[2] + old_turn[2]),
        )
        # A direction fixed in the world turns in the body by u x w dt.
        said = cross(old, middle)
        seen = (new[0] - old[0], new[1] - old[1], new[2] - old[2])
        keeps = math.exp(-seconds / self._tuning.memory)
        self._together = keeps * self._together + dot(said, seen)
        self._said = keeps * self._said + dot(said, said)
        self._seen = keeps * self._seen + dot(seen, seen)
        self._count = keeps * self._count + 3.0
        # Across the force, from the mean of two turns.
        self._noise = keeps * self._noise + self._variance
        if self._said > self._tuning.enough**2 + self._tuning.clear_noise * self._noise:
            self._judge()

    def _judge(self) -> None:
        explained = self._together / self._said
        left = max(0.0, self._seen - explained * self._together)
        sigma = math.sqrt(left / max(self._count - 1.0, 1.0) / self._said)
        if explained + self._tuning.clear * sigma < self._tuning.mirrored:
            self.is_believed = False
        elif explained - self._tuning.clear * sigma > self._tuning.mirrored:
            self.is_believed = True


class LivingAxes:
    """Tells a gyro of which some axes are dead: it does not see the robot lean.

    A simulated gyro without noise may rest on two axes and be right.
    """

    def __init__(self, tuning: GyroCheckTuning | None = None) -> None:
        self._tuning = tuning or GyroCheckTuning()
        self._last: list[Triple] = []
        self._alive = [False, False, False]
        self._noisy = 0

    @property
    def are_all(self) -> bool:
        """Whether every axis has changed; true until noise of another has shown itself."""
        return self._noisy < self._tuning.dead or all(self._alive)

    def add(self, rate: Triple) -> None:
        """Take the next rate, rad/s."""
        if all(self._alive):
            return
        if len(self._last) == 2:
            before, last = self._last
            bends = [abs(rate[k] - 2.0 * last[k] + before[k]) for k in range(3)]
            self._alive = [a or rate[k] != last[k] for k, a in enumerate(self._alive)]
            self._noisy += max(bends) > self._tuning.bend * max(map(abs, rate))
        self._last = [*self._last[-1:], rate]
