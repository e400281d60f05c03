"""The local disturbance as a function of place: repeated passes add no independent information.

The disturbance is a Gaussian process over the plane with covariance `s^2 exp(-distance / L)`. Its
values at a few centres on the path are shared unknowns. The residual at the nodes is an
Ornstein-Uhlenbeck process along the path (FITC: Snelson and Ghahramani, Sparse Gaussian processes
using pseudo-inputs, 2006).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray
from magcal_ros.core.smoother.state import Course, State
from magcal_ros.core.smoother.unknowns import STREET, VELOCITY

MOST = 32  # centres at most
CLOSEST = 5.0  # metres between centres at least
REVISIT_RATIO = 3.0  # ratio of path to straight line between two nodes for a repeated pass
SMALL_SCALE = 0.03  # fraction of the disturbance's variance with a small extent: manhole covers


@dataclass(frozen=True, eq=False)
class Places:
    """Centres of the Gaussian process, and their weights at the nodes."""

    weights: FloatArray
    """The expected disturbance at the nodes is `weights @ values at the centres`. Shape (n, k)."""
    chosen: IntArray  # the nodes where the centres are. Shape (k,).
    rest: FloatArray  # standard deviation of the residual over the disturbance's. Shape (n,).
    information: FloatArray  # inverse correlation of the centres. Shape (k, k).
    log_determinant: float  # of the correlation
    length: float  # correlation length of the residual, metres

    @classmethod
    def none(cls, count: int, length: float) -> Places:
        """Return no centres."""
        empty = np.zeros(0, dtype=int)
        return cls(np.zeros((count, 0)), empty, np.ones(count), np.zeros((0, 0)), 0.0, length)

    def __len__(self) -> int:
        return len(self.chosen)

    @classmethod
    def along(cls, course: Course, state: State, length: float) -> Places:
        """Return centres along the dead-reckoned path.

        Attitudes and velocities of the state give the path; `length` is the correlation length of
        the disturbance, metres.
        """
        way = dead_reckoned(course, state)
        again = np.flatnonzero(_passed_again(way, length))
        if not len(again):
            return cls.none(len(way), length)
        rows, apart = _spread_out(way[again], CLOSEST)
        chosen = again[rows]
        if len(again) < len(way):
            apart = length
        if len(chosen) < 2:
            return cls.none(len(way), length)
        centres = way[chosen]
        among = np.exp(-_distances(centres, centres) / length) + 1e-6 * np.eye(len(centres))
        to_nodes = np.exp(-_distances(way, centres) / length)
        information = np.asarray(np.linalg.inv(among), dtype=np.float64)
        weights = to_nodes @ information
        explained = (1.0 - SMALL_SCALE) * np.sum(weights * to_nodes, axis=1)
        rest = np.sqrt(np.clip(1.0 - explained, SMALL_SCALE, 1.0))
        determinant = float(np.linalg.slogdet(among)[1])
        return cls(weights, chosen, rest, information, determinant, min(apart, length))

    def disturbance(self, state: State) -> FloatArray:
        """Return the local disturbance at the nodes, µT, world axes, shape (n, 3)."""
        by_centres = np.asarray(self.weights @ state.centres)
        return by_centres + self.rest[:, None] * state.local[:, STREET]

    def with_disturbance(self, state: State, disturbance: FloatArray) -> State:
        """Return a state with a given disturbance, expressed by these centres."""
        centres = disturbance[self.chosen]
        local = state.local.copy()
        local[:, STREET] = (disturbance - self.weights @ centres) / self.rest[:, None]
        return replace(state, local=local, centres=centres)


def dead_reckoned(course: Course, state: State) -> FloatArray:
    """Return the nodes' positions by dead reckoning, east and north, metres, shape (n, 2)."""
    in_body = state.local[:, VELOCITY] @ course.axes[:, :2].T * course.moving[:, None]
    velocity = np.einsum("nji,nj->ni", state.attitude, in_body)[:, :2]
    steps = 0.5 * (velocity[1:] + velocity[:-1]) * course.nodes.seconds[:, None]
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def _passed_again(way: FloatArray, length: float) -> BoolArray:
    """Return which nodes (n,) are near another node that is far away along the path."""
    steps = np.linalg.norm(np.diff(way, axis=0), axis=1)
    metres = np.concatenate([[0.0], np.cumsum(steps)])
    along = np.abs(metres[:, None] - metres)
    apart = _distances(way, way)
    again = (along > REVISIT_RATIO * apart) & (along > CLOSEST) & (apart < length)
    return np.asarray(again.any(axis=1))


def _distances(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(one[:, None] - other, axis=2))


def _spread_out(way: FloatArray, closest: float) -> tuple[list[int], float]:
    """Return rows far from one another (greedily), and the largest distance of any row to them.

    At most `MOST` rows (farthest-point sampling).
    """
    chosen = [0]
    distance = np.linalg.norm(way - way[0], axis=1)
    while len(chosen) < MOST and distance.max() > closest:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(way - way[chosen[-1]], axis=1))
    return chosen, max(float(distance.max()), closest)
