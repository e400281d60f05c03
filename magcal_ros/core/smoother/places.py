"""The local disturbance as a function of place: repeated passes add no independent information.

The disturbance is a Gaussian process over the plane. Most of its variance has the correlation
`exp(-distance / L)` with a length of tens of metres; the rest is alike over two metres (covers,
parked cars). Its values at a few centres on the path are shared unknowns. The residual at the nodes
is an Ornstein-Uhlenbeck process along the path (FITC: Snelson and Ghahramani, Sparse Gaussian
processes using pseudo-inputs, 2006).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray
from magcal_ros.core.smoother.state import Course, State
from magcal_ros.core.smoother.unknowns import STREET, VELOCITY

MOST = 32  # centres at most
REVISIT_RATIO = 3.0  # ratio of path to straight line between two nodes for a repeated pass
NEAR_SHARE, NEAR_LENGTH = 0.3, 2.0
"""Share of the variance that is alike over a few metres only, and their number: in streets 20 to
40% of it changes within 2 m."""
CLOSEST = 0.375 * NEAR_LENGTH
"""Metres between centres, at least. If it is larger, the field that each lap of a small circle
repeats counts as noise; if it is smaller, small circles have denser centres than large ones, and
count as too likely."""
LEAST_REST = 0.003  # smallest share of the variance that is left to a node


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
    is_repeated: BoolArray  # whether the path passes near a node several times. Shape (n,).

    @classmethod
    def none(cls, count: int, length: float) -> Places:
        """Return no centres."""
        empty = np.zeros(0, dtype=int)
        never = np.zeros(count, dtype=np.bool_)
        return cls(
            np.zeros((count, 0)), empty, np.ones(count), np.zeros((0, 0)), 0.0, length, never
        )

    def __len__(self) -> int:
        return len(self.chosen)

    @classmethod
    def along(cls, course: Course, state: State, length: float) -> Places:
        """Return centres along the dead-reckoned path.

        Attitudes and velocities of the state give the path; `length` is the correlation length of
        the disturbance, metres.
        """
        way = dead_reckoned(course, state)
        is_repeated = _passed_again(way, length)
        again = np.flatnonzero(is_repeated)
        if not len(again):
            return cls.none(len(way), length)
        rows, apart = _spread_out(way[again], CLOSEST)
        chosen = again[rows]
        if len(again) < len(way):
            apart = length
        if len(chosen) < 2:
            return cls.none(len(way), length)
        centres = way[chosen]
        among = _correlation(_distances(centres, centres), length) + 1e-6 * np.eye(len(centres))
        # The mean over a node's piece of the path is that of the middles of its thirds.
        within = np.array([-1.0, 0.0, 1.0])[:, None] / 3.0
        pieces = way[:, None] + within * np.gradient(way, axis=0)[:, None]
        to_nodes = _correlation(_distances(pieces, centres), length).mean(axis=1)
        own = _correlation(_distances(pieces, pieces), length).mean(axis=(1, 2))
        information = np.asarray(np.linalg.inv(among), dtype=np.float64)
        weights = to_nodes @ information
        explained = np.sum(weights * to_nodes, axis=1)
        rest = np.sqrt(np.clip(own - explained, LEAST_REST, 1.0))
        determinant = float(np.linalg.slogdet(among)[1])
        return cls(weights, chosen, rest, information, determinant, min(apart, length), is_repeated)

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
    velocity = state.local[:, VELOCITY] * course.moving[:, None]
    to_world = np.swapaxes(state.attitude, 1, 2) @ state.vehicle_axes
    velocity = np.einsum("nij,nj->ni", to_world[:, :2, :2], velocity)
    steps = 0.5 * (velocity[1:] + velocity[:-1]) * course.nodes.seconds[:, None]
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def _passed_again(way: FloatArray, length: float) -> BoolArray:
    """Return which nodes (n,) are near another node that is far away along the path."""
    steps = np.linalg.norm(np.diff(way, axis=0), axis=1)
    metres = np.concatenate([[0.0], np.cumsum(steps)])
    along = np.abs(metres[:, None] - metres)
    apart = _distances(way, way)
    again = (along > REVISIT_RATIO * np.maximum(apart, NEAR_LENGTH)) & (apart < length)
    return np.asarray(again.any(axis=1))


def _correlation(distance: FloatArray, length: float) -> FloatArray:
    """Return the correlation of the disturbance at two places, by their distance in metres."""
    far = (1.0 - NEAR_SHARE) * np.exp(-distance / length)
    return np.asarray(far + NEAR_SHARE * np.exp(-distance / NEAR_LENGTH))


def _distances(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the distances of places (..., n, 2) and (..., k, 2), metres, shape (..., n, k)."""
    return np.asarray(np.linalg.norm(one[..., :, None, :] - other[..., None, :, :], axis=-1))


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
