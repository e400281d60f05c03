"""Whether the gyro turns as the accelerometer does; one that is mirrored must not carry up."""

from __future__ import annotations

import math

from magcal_ros.core.triples import Triple, cross, dot

MEMORY = 20.0
"""Seconds of which the evidence is kept."""
ENOUGH = 0.01
"""Sum of squared changes over gravity, as of a nod by 6°, before anything is said."""
MIRRORED = -0.3
"""How much of the turns a gyro gets right: all is one, a pull in a circle adds nothing, and a
mirrored one gets them right with the wrong sign."""
CLEAR = 3.0
"""Sigmas."""


class GyroCheck:
    """Compares how the specific force changes with how the gyro says it should."""

    def __init__(self) -> None:
        self.is_believed = True
        self._force: Triple | None = None
        self._turn: Triple = (0.0, 0.0, 0.0)
        self._together = self._said = self._seen = self._count = 0.0

    def restart(self) -> None:
        """Do not compare the next block with the one before."""
        self._force = None

    def add(self, force: Triple, turn: Triple, seconds: float) -> None:
        """Take a block: its mean force over gravity, the rotation vector over it, its length."""
        before, before_turn = self._force, self._turn
        self._force, self._turn = force, turn
        if before is None:
            return
        middle = (
            0.5 * (turn[0] + before_turn[0]),
            0.5 * (turn[1] + before_turn[1]),
            0.5 * (turn[2] + before_turn[2]),
        )
        # A direction fixed in the world turns in the body by u x w dt.
        said = cross(before, middle)
        seen = (force[0] - before[0], force[1] - before[1], force[2] - before[2])
        keeps = math.exp(-seconds / MEMORY)
        self._together = keeps * self._together + dot(said, seen)
        self._said = keeps * self._said + dot(said, said)
        self._seen = keeps * self._seen + dot(seen, seen)
        self._count = keeps * self._count + 3.0
        if self._said > ENOUGH * ENOUGH:
            self._judge()

    def _judge(self) -> None:
        explained = self._together / self._said
        left = max(0.0, self._seen - explained * self._together)
        sigma = math.sqrt(left / max(self._count - 1.0, 1.0) / self._said)
        if explained + CLEAR * sigma < MIRRORED:
            self.is_believed = False
        elif explained - CLEAR * sigma > MIRRORED:
            self.is_believed = True
