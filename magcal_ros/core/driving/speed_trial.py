"""Whether a speed explains the force of the last seconds, from running sums."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple


class Tried(NamedTuple):
    """Force across up, and change of velocity if the IMU looked ahead, m/s².

    `pull` is the latter's part along the vehicle.
    """

    force: complex
    change: complex
    pull: float


class SpeedTrial:
    """The newest forces and changes of velocity, and how they scatter.

    Parameters
    ----------
    most : int
        How many are looked at.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._tried: deque[Tried] = deque()
        self.clear()

    def __len__(self) -> int:
        return len(self._tried)

    def clear(self) -> None:
        """Forget them."""
        self._tried.clear()
        self._force = self._change = self._both = 0j
        self._forces = self._changes = self._pulls = 0.0

    def add(self, tried: Tried) -> None:
        """Take the newest, and leave the oldest."""
        self._tried.append(tried)
        self._sum(tried, 1.0)
        if len(self._tried) > self._most:
            self._sum(self._tried.popleft(), -1.0)

    def turn_back(self, count: int) -> None:
        """Turn the newest so many changes round: the vehicle has backed up."""
        all_of_them = list(self._tried)
        first = max(0, len(all_of_them) - count)
        self.clear()
        for index, tried in enumerate(all_of_them):
            self.add(tried if index < first else tried._replace(change=-tried.change))

    @property
    def last(self) -> Tried:
        """The newest as it was added."""
        return self._tried[-1]

    def left(self, turn: complex) -> complex:
        """Return the mean of the force less `turn` times the change; zero before the first."""
        return (self._force - turn * self._change) / max(1, len(self._tried))

    @property
    def newest(self) -> Tried:
        """The newest, less the means."""
        count, (force, change, pull) = len(self._tried), self._tried[-1]
        return Tried(force - self._force / count, change - self._change / count, pull)

    @property
    def pull_share(self) -> float:
        """Share of the changes that lies along the vehicle: starts and stops."""
        return self._pulls / self._changes if self._changes > 0.0 else 0.0

    def scatter(self, turn: complex) -> float:
        """Return the variance of the force less `turn` times the change, (m/s²)²."""
        count = len(self._tried)
        force = self._forces / count - abs(self._force / count) ** 2
        change = self._changes / count - abs(self._change / count) ** 2
        both = self._both / count - self._force * self._change.conjugate() / count**2
        crossed: float = (both * turn.conjugate()).real
        return max(0.0, force - 2.0 * crossed + abs(turn) ** 2 * change)

    def _sum(self, tried: Tried, sign: float) -> None:
        force, change, pull = tried
        self._force += sign * force
        self._change += sign * change
        self._both += sign * force * change.conjugate()
        self._forces += sign * abs(force) ** 2
        self._changes += sign * abs(change) ** 2
        self._pulls += sign * pull * pull
