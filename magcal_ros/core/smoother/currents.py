"""The current of a battery in each node, and what its uncertainty adds to the field.

Between two messages the current is modelled as a random walk. Its variance grows at one rate at
rest and at another in motion, and also where the turn rate changes, as motors start and stop there.
In motion a ripple is added, which is shorter than the time between two messages. Messages have
noise. The rates of variance, the ripple and the noise are estimated from the differences of
neighbouring messages. The mean of the walk between two messages is linear in its accumulated
variance (`Clock`), and its variance is that of a Brownian bridge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import (
    BoolArray,
    FloatArray,
    accumulated,
    integral,
    interpolated,
)
from magcal_ros.core.samples.battery import Battery
from magcal_ros.core.smoother.unknowns import AT, CURRENT_LATE, MOST_SPREADS, UNKNOWNS, USUALLY_LATE

MARGIN = 1e4  # of the clock before the first and after the last message, s and A²
POINTS = (np.arange(8) + 0.5) / 8.0  # fractions of a node at which the current is computed
START_TIME = 0.1  # seconds in which motors start
STEP = 0.02  # seconds, of the derivative by the delay
SPREAD = UNKNOWNS["motors_current"].spread
"""Prior standard deviation of the natural logarithm of each rate and variance: that of the field,
as both depend on the robot alone."""
NOISE = 0.01  # usual noise of a message over the largest current
LEAST = 1e-6  # A² that is added to each variance


@dataclass(frozen=True, eq=False)
class Clock:
    """Accumulated variance of the current's random walk over time."""

    time: FloatArray  # seconds, increasing. Shape (m,).
    variance: FloatArray  # A², increasing. Shape (m,).
    motion: FloatArray  # seconds of motion up to each moment. Shape (m,).
    ripple: float  # variance of the ripple in motion, A²
    noise: float  # variance of a message, A²

    @classmethod
    def of(cls, battery: Battery, time: FloatArray, rate: FloatArray, rests: BoolArray) -> Clock:
        """Return the clock for a battery's messages, from turn rates (m, 3) and rests (m,)."""
        parts = np.column_stack(
            [
                integral(time, rests.astype(float)),
                integral(time, (~rests).astype(float)),
                integral(time, _squared_acceleration(time, rate)),
            ]
        )
        beyond = np.array([MARGIN, 0.0, 0.0])
        time = np.concatenate([[time[0] - MARGIN], time, [time[-1] + MARGIN]])
        parts = np.vstack([-beyond, parts, parts[-1] + beyond])
        sizes = _sizes(battery, time, parts)
        ripple, noise = sizes[-2:].tolist()
        return cls(time, parts @ sizes[:-2], parts[:, 1], ripple, noise)

    def at(self, moments: FloatArray) -> FloatArray:
        """Return the accumulated variance at moments, A²."""
        return np.interp(moments, self.time, self.variance)

    def message_variance(self, moments: FloatArray) -> FloatArray:
        """Return the variance of messages at moments about the walk, A²."""
        return np.asarray(self.noise + self.ripple * _moves(moments, self.time, self.motion))


def _moves(moments: FloatArray, time: FloatArray, motion: FloatArray) -> FloatArray:
    """Return the fraction of the time around moments in which the robot moves."""
    around = [np.interp(moments + by, time, motion) for by in (-START_TIME, START_TIME)]
    return np.asarray((around[1] - around[0]) / (2.0 * START_TIME))


def _squared_acceleration(time: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the squared angular acceleration, (rad/s²)², shape (m,)."""
    angle = integral(time, rate)
    ahead, behind = (interpolated(time + by, time, angle) for by in (START_TIME, -START_TIME))
    return np.asarray(np.sum((ahead - 2.0 * angle + behind) ** 2, axis=1) / START_TIME**4)


def _sizes(battery: Battery, time: FloatArray, parts: FloatArray) -> FloatArray:
    """Return the most likely rates of variance, and the variances of ripple and noise, A².

    The rates are per unit of each column of `parts` (m, k). The estimate uses the differences of
    neighbouring messages, at the most likely delay. Shape (k + 2,).
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
    for delay in USUALLY_LATE * np.arange(5):
        moments = battery.time - delay
        passed = np.diff(interpolated(moments, time, parts), axis=0)
        moves = _moves(moments, time, parts[:, 1])

        def cost(logs: FloatArray, passed: FloatArray = passed, moves: FloatArray = moves) -> float:
            sizes = np.exp(logs)
            known, _ = _explained(steps, passed @ sizes[:-2], sizes[-2] * moves + sizes[-1])
            off = (logs - usual) / SPREAD
            return known + float(off @ off)

        made = minimize(cost, found, method="L-BFGS-B", bounds=bounds, options={"maxiter": 30})
        more = ((delay - USUALLY_LATE) / late) ** 2
        if made.fun + more < best:
            best, found = made.fun + more, made.x
    return np.asarray(np.exp(found))


def _explained(
    steps: FloatArray, walked: FloatArray, ripple: FloatArray
) -> tuple[float, FloatArray]:
    """Return how well a walk with a ripple explains differences of neighbouring messages (k - 1,).

    Returned are minus twice the logarithm of the likelihood, up to a constant, and the posterior
    mean of each message's ripple, A, (k,). The variances of the walk (k - 1,), and of ripple and
    noise (k,), are in A². The covariance of the differences is banded.
    """
    from scipy.linalg import cho_solve_banded, cholesky_banded

    band = np.zeros((2, len(walked)))
    band[0, 1:] = -ripple[1:-1]
    band[1] = walked + ripple[1:] + ripple[:-1] + LEAST
    factor = cholesky_banded(band)
    solved = cho_solve_banded((factor, False), steps)
    cost = float(2.0 * np.sum(np.log(factor[1])) + steps @ solved)
    return cost, np.asarray(ripple * -np.diff(solved, prepend=0.0, append=0.0))


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
        return (self._means(delay + STEP) - self._means(delay - STEP)) / (2.0 * STEP)

    def _means(self, delay: float) -> FloatArray:
        moments, current = self.battery.time - delay, self.battery.current
        known, variance = self.clock.at(moments), self.clock.message_variance(moments)
        _, ripple = _explained(np.diff(current), np.diff(known), variance)
        now = np.interp(self.clock.at(self._moments), known, current - ripple)
        return np.asarray(now.mean(axis=1))

    def variance(self, delay: float) -> FloatArray:
        """Return the variance of each node's current, given the messages, A², (n,).

        The errors of the nodes between two messages are correlated. Each variance is the sum of a
        node's covariances with all nodes, so that independent nodes have the same total variance.
        """
        points = self.clock.at(self._moments)
        known = self.clock.at(self.battery.time - delay)
        known = np.concatenate([[known[0] - MARGIN], known, [known[-1] + MARGIN]])
        at = np.sort(points, axis=None)
        total = accumulated(at)

        def walked(variance: FloatArray) -> FloatArray:
            """Return the covariance of a free walk with the sum of its values at all points."""
            earlier = np.searchsorted(at, variance)
            return np.asarray(total[earlier] + (len(at) - earlier) * variance) / len(POINTS)

        # The mean between two messages is linear, and its error is independent of the messages.
        bridge = (walked(points) - np.interp(points, known, walked(known))).mean(axis=1)
        between = float(np.median(np.diff(self.battery.time)))
        ripple = self.clock.message_variance(self._moments).mean(axis=1)
        # The ripple is correlated from one message to the next.
        return np.asarray(bridge + ripple * between / (self.end - self.begin))

    @property
    def _moments(self) -> FloatArray:
        """The moments in each node at which the current is computed, s, (n, len(POINTS))."""
        return np.asarray(self.begin[:, None] + (self.end - self.begin)[:, None] * POINTS)

    def with_rest(self, at: int, begin: float, end: float) -> Currents:
        """Return the currents with a rest inserted as two nodes at row `at`."""
        nodes = np.array([at, at])
        return Currents(
            self.battery,
            self.clock,
            np.insert(self.begin, nodes, begin),
            np.insert(self.end, nodes, end),
        )


def scale_by_current(
    currents: Currents | None, shared: FloatArray, variance: FloatArray, most: float
) -> FloatArray | None:
    """Return what scales the field's residuals down along the motors' field, shape (n, 3, 3).

    The scaled residuals have `variance` per axis (n,) in all directions, including the uncertainty
    of the current. `most` is the largest field per axis that the motors may add at the largest
    current, µT, until the iterations have estimated it. None without currents.
    """
    if currents is None:
        return None
    gain = shared[AT["motors_current"]]
    unknown = currents.variance(shared[CURRENT_LATE])
    square, other = float(gain @ gain), (most / currents.battery.largest) ** 2
    along, across = (
        np.sqrt(variance / (variance + each * unknown)) for each in (square + other, other)
    )
    direction = np.outer(gain, gain) / max(square, 1e-12)
    return np.asarray(
        along[:, None, None] * direction + across[:, None, None] * (np.eye(3) - direction)
    )
