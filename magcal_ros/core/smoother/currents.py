"""The current of a battery in each node.

Between two messages nobody measures the current. It is a random walk there, by a clock that goes at
one pace at rest, at another in motion, and ahead wherever the turn rate changes: there motors start
and stop. The paces are those that explain best how the messages differ. The mean of the current
between two messages is then linear in the clock, and its variance that of a Brownian bridge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, integral
from magcal_ros.core.samples.battery import Battery
from magcal_ros.core.smoother.unknowns import UNKNOWNS, USUALLY_LATE

FAR = 1e4  # seconds beyond the first and the last message, up to which the current stays
POINTS = (np.arange(8) + 0.5) / 8.0  # of a node at which the current is computed, as shares of it
STARTS = 0.1  # seconds in which motors start
SHORT = 0.02  # seconds of a delay's change, by which derivatives are taken
DELAYS = np.arange(0.0, 0.41, 0.05)  # seconds by which the messages may be late, for the paces
PACE_SPREAD = 2.0
"""Standard deviation of the natural logarithm of each pace, about that of all motions."""


@dataclass(frozen=True, eq=False)
class Clock:
    """How far the current may have changed up to any moment, as a variance."""

    time: FloatArray  # seconds, increasing. Shape (m,).
    variance: FloatArray  # A², increasing. Shape (m,).

    @classmethod
    def of(cls, battery: Battery, time: FloatArray, rate: FloatArray, rests: BoolArray) -> Clock:
        """Return the clock of a battery's messages, by turn rates (m, 3) and rests (m,)."""
        parts = np.column_stack(
            [
                integral(time, rests.astype(float)),
                integral(time, (~rests).astype(float)),
                integral(time, _square_of_change(time, rate)),
            ]
        )
        beyond = np.array([FAR, 0.0, 0.0])
        time = np.concatenate([[time[0] - FAR], time, [time[-1] + FAR]])
        parts = np.vstack([-beyond, parts, parts[-1] + beyond])
        return cls(time, parts @ _paces(battery, time, parts))

    def at(self, moments: FloatArray) -> FloatArray:
        """Return the variance up to moments, A²."""
        return np.interp(moments, self.time, self.variance)


def _square_of_change(time: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the squares of the change of the turn rate, (rad/s²)², shape (m,)."""
    angle = integral(time, rate)
    ahead, behind = (
        np.column_stack([np.interp(time + by, time, each) for each in angle.T])
        for by in (STARTS, -STARTS)
    )
    return np.asarray(np.sum((ahead - 2.0 * angle + behind) ** 2, axis=1) / STARTS**4)


def _paces(battery: Battery, time: FloatArray, parts: FloatArray) -> FloatArray:
    """Return the most likely pace of each part of the clock (m, k), A² over its unit, shape (k,).

    By the differences of neighbouring messages, and by how late these may be.
    """
    square = np.diff(battery.current) ** 2
    late = UNKNOWNS["current_late"].sigma[0]
    best, found = math.inf, np.zeros(parts.shape[1])
    for delay in DELAYS:
        moments = battery.time - delay
        passed = np.diff([np.interp(moments, time, part) for part in parts.T]).T
        cost, paces = _most_likely(passed, square)
        cost += ((delay - USUALLY_LATE) / late) ** 2
        if cost < best:
            best, found = cost, paces
    return found


def _most_likely(passed: FloatArray, square: FloatArray) -> tuple[float, FloatArray]:
    """Return the least cost, and the paces (k,) by which steps `passed` (n, k) have such squares.

    The cost is minus twice the logarithm of the likelihood with a log-normal prior.
    """
    whole = passed.sum(axis=0)
    usual = np.log(square.sum() / np.maximum(whole, 1e-3))

    def cost(logs: FloatArray) -> tuple[float, FloatArray]:
        by_part = passed * np.exp(logs)
        variance = by_part.sum(axis=1) + 1e-9
        off = (logs - usual) / PACE_SPREAD
        slope = (1.0 / variance - square / variance**2) @ by_part + 2.0 * off / PACE_SPREAD
        total = np.sum(np.log(variance) + square / variance) + off @ off
        return float(total), slope

    found = minimize(cost, usual, jac=True, method="L-BFGS-B")
    return float(found.fun), np.exp(found.x)


@dataclass(frozen=True, eq=False)
class Currents:
    """Means of the current over the nodes."""

    battery: Battery
    clock: Clock
    begin: FloatArray
    end: FloatArray  # of each node's samples, seconds. Shapes (n,).

    def at(self, delay: float) -> tuple[FloatArray, FloatArray]:
        """Return the currents beyond the reference, A, and their change by the delay, A/s, (n,).

        A message tells the current that flowed `delay` seconds before its stamp.
        """
        moments = self.clock.at(self._moments)
        before, now, after = (
            np.interp(moments, self.clock.at(self.battery.time - each), self.battery.current)
            for each in (delay - SHORT, delay, delay + SHORT)
        )
        mean = now.mean(axis=1) - self.battery.reference
        return mean, (after - before).mean(axis=1) / (2.0 * SHORT)

    def variance(self, delay: float) -> FloatArray:
        """Return the variance of each node's current by what no message tells, A², (n,).

        The nodes between two messages share it. Nodes that each had the sum of their covariances
        with all nodes would be as wrong together.
        """
        points = self.clock.at(self._moments).ravel()
        order = np.argsort(points, kind="stable")
        told = self.clock.at(self.battery.time - delay)
        told = np.concatenate([[told[0] - FAR], told, [told[-1] + FAR]])
        at = points[order]
        row = np.searchsorted(told, at, side="right").clip(1, len(told) - 1)
        start, end = told[row - 1], told[row]
        share = 1.0 / len(POINTS)
        number = share * np.arange(len(at) + 1)
        moved = np.concatenate([[0.0], share * np.cumsum(at)])
        first, last = np.searchsorted(row, row), np.searchsorted(row, row, side="right")
        here = np.arange(1, len(at) + 1)
        earlier = moved[here] - moved[first] - start * (number[here] - number[first])
        later = end * (number[last] - number[here]) - (moved[last] - moved[here])
        both = ((end - at) * earlier + (at - start) * later) / (end - start)
        found = np.empty_like(both)
        found[order] = both
        return np.asarray(found.reshape(-1, len(POINTS)).mean(axis=1))

    @property
    def _moments(self) -> FloatArray:
        """The moments in each node at which the current is computed, s, (n, len(POINTS))."""
        return np.asarray(self.begin[:, None] + (self.end - self.begin)[:, None] * POINTS)

    def with_rest(self, at: int, begin: float, end: float) -> Currents:
        """Return the currents with a rest from one moment to another as two nodes, from `at` on."""
        nodes = np.array([at, at])
        return Currents(
            self.battery,
            self.clock,
            np.insert(self.begin, nodes, begin),
            np.insert(self.end, nodes, end),
        )

    def part(self, rows: slice) -> Currents:
        """Return the currents of some nodes."""
        return Currents(self.battery, self.clock, self.begin[rows], self.end[rows])
