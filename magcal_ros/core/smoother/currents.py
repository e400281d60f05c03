"""The current of a battery in each node.

Between two messages the current is not measured. It is a random walk there, by a clock that goes at
one pace at rest, at another in motion, and ahead wherever the turn rate changes: there motors start
and stop. In motion a ripple comes on top, which lasts for less than the time between two messages.
Messages have noise. Paces, ripple and noise are those that explain best how the messages differ.
The mean of the walk between two messages is then linear in the clock, and its variance that of a
Brownian bridge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, integral
from magcal_ros.core.samples.battery import Battery
from magcal_ros.core.smoother.unknowns import UNKNOWNS, USUALLY_LATE

FAR = 1e4  # seconds beyond the first and the last message, up to which the current stays
POINTS = (np.arange(8) + 0.5) / 8.0  # of a node at which the current is computed, as shares of it
STARTS = 0.1  # seconds in which motors start
SHORT = 0.02  # seconds of a delay's change, by which derivatives are taken
DELAYS = np.arange(0.0, 0.41, 0.1)  # seconds by which the messages may be late, for the paces
SPREAD = 2.0
"""Standard deviation of the natural logarithm of each pace, and of the variances of the rest."""
MOST_SPREADS = 4.0  # up to which they may differ from the usual
NOISE = 0.01  # usual noise of a message over the largest current
LEAST = 1e-6  # A² that is added to each variance


@dataclass(frozen=True, eq=False)
class Clock:
    """How far the current may have changed up to any moment, as a variance."""

    time: FloatArray  # seconds, increasing. Shape (m,).
    variance: FloatArray  # A², increasing. Shape (m,).
    motion: FloatArray  # seconds of motion up to each moment. Shape (m,).
    ripple: float  # variance in motion beside that, A²
    noise: float  # variance of a message, A²

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
        sizes = _sizes(battery, time, parts)
        ripple, noise = sizes[-2:].tolist()
        return cls(time, parts @ sizes[:-2], parts[:, 1], ripple, noise)

    def at(self, moments: FloatArray) -> FloatArray:
        """Return the variance up to moments, A²."""
        return np.interp(moments, self.time, self.variance)

    def beside(self, moments: FloatArray) -> FloatArray:
        """Return the variance by which messages at moments differ from the walk, A²."""
        return np.asarray(self.noise + self.ripple * _moves(moments, self.time, self.motion))


def _moves(moments: FloatArray, time: FloatArray, motion: FloatArray) -> FloatArray:
    """Return the share of the time in which the robot moves around moments."""
    around = [np.interp(moments + by, time, motion) for by in (-STARTS, STARTS)]
    return np.asarray((around[1] - around[0]) / (2.0 * STARTS))


def _square_of_change(time: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the squares of the change of the turn rate, (rad/s²)², shape (m,)."""
    angle = integral(time, rate)
    ahead, behind = (
        np.column_stack([np.interp(time + by, time, each) for each in angle.T])
        for by in (STARTS, -STARTS)
    )
    return np.asarray(np.sum((ahead - 2.0 * angle + behind) ** 2, axis=1) / STARTS**4)


def _sizes(battery: Battery, time: FloatArray, parts: FloatArray) -> FloatArray:
    """Return the most likely paces, A² over the unit of each part of the clock (m, k), and more.

    By the differences of neighbouring messages, and by how late these may be. The last two are the
    variances of ripple and noise, A². Shape (k + 2,).
    """
    from scipy.optimize import minimize

    steps = np.diff(battery.current)
    late = UNKNOWNS["current_late"].sigma[0]
    whole = parts[-2] - parts[1]
    square = float(steps @ steps)
    usual = square / np.append(np.maximum(whole, 1e-3), 2.0 * len(steps))
    usual = np.log(np.append(usual, (NOISE * battery.largest) ** 2))
    bounds = [(each - MOST_SPREADS * SPREAD, each + MOST_SPREADS * SPREAD) for each in usual]
    best, found = math.inf, usual
    for delay in DELAYS:
        moments = battery.time - delay
        passed = np.diff([np.interp(moments, time, part) for part in parts.T]).T
        moves = _moves(moments, time, parts[:, 1])

        def cost(logs: FloatArray, passed: FloatArray = passed, moves: FloatArray = moves) -> float:
            sizes = np.exp(logs)
            steps_by = _Steps.of(passed @ sizes[:-2], sizes[-2] * moves + sizes[-1])
            off = (logs - usual) / SPREAD
            return steps_by.cost(steps) + float(off @ off)

        made = minimize(cost, found, method="L-BFGS-B", bounds=bounds, options={"maxiter": 30})
        more = ((delay - USUALLY_LATE) / late) ** 2
        if made.fun + more < best:
            best, found = made.fun + more, made.x
    return np.asarray(np.exp(found))


@dataclass(frozen=True, eq=False)
class _Steps:
    """The steps from message to message of a walk with a ripple, whose covariance is banded."""

    ripple: FloatArray  # variance of each message's ripple and noise, A². Shape (k,).
    factor: FloatArray  # of the covariance, by Cholesky. Shape (2, k - 1).

    @classmethod
    def of(cls, walked: FloatArray, ripple: FloatArray) -> _Steps:
        """Return them by the variances of the walk's steps (k - 1,) and of the ripple (k,), A²."""
        from scipy.linalg import cholesky_banded

        band = np.zeros((2, len(walked)))
        band[0, 1:] = -ripple[1:-1]
        band[1] = walked + ripple[1:] + ripple[:-1] + LEAST
        return cls(ripple, cholesky_banded(band))

    def cost(self, steps: FloatArray) -> float:
        """Return minus twice the logarithm of the likelihood, up to a constant."""
        solved = self._solved(steps)
        return float(2.0 * np.sum(np.log(self.factor[1])) + steps @ solved)

    def of_ripple(self, steps: FloatArray) -> FloatArray:
        """Return the mean of each message's ripple, A, (k,)."""
        return np.asarray(self.ripple * -np.diff(self._solved(steps), prepend=0.0, append=0.0))

    def _solved(self, steps: FloatArray) -> FloatArray:
        from scipy.linalg import cho_solve_banded

        return np.asarray(cho_solve_banded((self.factor, False), steps))


@dataclass(frozen=True, eq=False)
class Currents:
    """Means of the current over the nodes."""

    battery: Battery
    clock: Clock
    begin: FloatArray
    end: FloatArray  # of each node's samples, seconds. Shapes (n,).

    def at(self, delay: float) -> FloatArray:
        """Return the currents beyond the reference, A, (n,).

        A message shows the current that flowed `delay` seconds before its stamp.
        """
        return self._means(delay) - self.battery.reference

    def change(self, delay: float) -> FloatArray:
        """Return the derivative of the currents by the delay, A/s, (n,)."""
        return (self._means(delay + SHORT) - self._means(delay - SHORT)) / (2.0 * SHORT)

    def _means(self, delay: float) -> FloatArray:
        now = np.interp(self.clock.at(self._moments), *self._walk(delay))
        return np.asarray(now.mean(axis=1))

    def _walk(self, delay: float) -> tuple[FloatArray, FloatArray]:
        """Return the clock at the messages, A², and the current without its ripple there, A."""
        moments, current = self.battery.time - delay, self.battery.current
        known = self.clock.at(moments)
        steps = _Steps.of(np.diff(known), self.clock.beside(moments))
        return known, current - steps.of_ripple(np.diff(current))

    def variance(self, delay: float) -> FloatArray:
        """Return the variance of each node's current that no message shows, A², (n,).

        The nodes between two messages share it. Nodes that each had the sum of their covariances
        with all nodes would be as wrong together.
        """
        points = self.clock.at(self._moments).ravel()
        order = np.argsort(points, kind="stable")
        known = self.clock.at(self.battery.time - delay)
        known = np.concatenate([[known[0] - FAR], known, [known[-1] + FAR]])
        at = points[order]
        row = np.searchsorted(known, at, side="right").clip(1, len(known) - 1)
        start, end = known[row - 1], known[row]
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
        bridge = found.reshape(-1, len(POINTS)).mean(axis=1)
        between = float(np.median(np.diff(self.battery.time)))
        beside = self.clock.beside(self._moments).mean(axis=1)
        # It lasts from one message to the next.
        return np.asarray(bridge + beside * between / (self.end - self.begin))

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
