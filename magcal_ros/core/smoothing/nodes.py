"""From samples to nodes: means over half a second, turned together by gyro and up."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.rotations import exp_rotations, turns_about_z
from magcal_ros.core.samples.streams import STREAMS
from magcal_ros.core.smoothing.tuning import TUNING

MICROTESLA = 1e6


@dataclass(frozen=True)
class LeanDoubt:
    """How far up may lean all along, with the robot: in steady bends a gyro's bias is a lean."""

    information: float = math.inf
    """What a drive says of the bias across up, per (rad/s)²."""
    per_bias: float = 0.0
    """Radians that up leans for each rad/s of bias."""
    usual: float = TUNING.usual_bias
    """rad/s per axis: one sigma of a bias beforehand."""
    wander: float = 0.0
    """Share of the square by which up varies that is error of up. The downward field is found by so
    much too small, and the hard iron along up with it."""

    def sigma(self, about_up: float) -> float:
        """Return it in radians, for a gyro whose bias about up is known to be so large, rad/s.

        A gyro that is far off about up is off about the other axes.
        """
        return self.per_bias / math.sqrt(self.information + max(self.usual, about_up) ** -2)


@dataclass(frozen=True, eq=False)
class Nodes:
    """Stretches of driving, one after another; each is told from the one before."""

    time: FloatArray
    """Seconds of the middle. Shape (n,)."""
    field: FloatArray
    """Mean field in nominal body axes, microtesla. Shape (n, 3)."""
    axes: FloatArray
    """Mean rotation from levelled axes, whose x lies under body x in the middle of the node, to
    body axes. Where the robot turned inside the node it is shorter than a rotation. Shape (n, 3,
    3)."""
    turned: FloatArray
    """Radians of yaw by the gyro from the middle of the node before. Shape (n,)."""
    seconds: FloatArray
    metres: FloatArray
    """From there, too. Shape (n,)."""
    is_tied: BoolArray
    """Whether the gyro was heard all the way from there; never for the first. Shape (n,)."""
    lean: LeanDoubt = LeanDoubt()
    """Of up."""
    iron_from: float = -math.inf
    """Clock from which the hard iron that is sought is there, seconds."""

    def __len__(self) -> int:
        return len(self.time)

    @property
    def heading(self) -> FloatArray:
        """Yaw by the gyro since the first node, radians, shape (n,)."""
        return np.cumsum(self.turned)

    @property
    def has_iron(self) -> FloatArray:
        """One where the hard iron that is sought is there, zero before, shape (n,)."""
        return (self.time >= self.iron_from).astype(np.float64)

    @property
    def tied_share(self) -> float:
        """Share of the nodes up to which the gyro was heard all the way; the first is left out."""
        return float(self.is_tied[1:].mean()) if len(self) > 1 else 1.0

    def take(self, rows: IntArray) -> Nodes:
        """Return some of the nodes, increasing; ways and turns between them are joined."""
        rows = np.asarray(rows)
        if not len(rows):
            raise ValueError("no node is left")
        first = np.concatenate([[0], rows[:-1] + 1])
        sums = [
            np.add.reduceat(np.append(values, 0.0), np.column_stack([first, rows + 1]).ravel())[::2]
            for values in (self.turned, self.seconds, self.metres, (~self.is_tied).astype(float))
        ]
        turned, seconds, metres, broken = sums
        tied = broken == 0.0
        for values in (turned, seconds, metres):
            values[0] = 0.0
        tied[0] = False
        return Nodes(
            self.time[rows],
            self.field[rows],
            self.axes[rows],
            turned,
            seconds,
            metres,
            tied,
            self.lean,
            self.iron_from,
        )


@dataclass(frozen=True, eq=False)
class Track:
    """Samples of a drive with their up, before they are averaged."""

    time: FloatArray
    """Seconds, increasing. Shape (m,)."""
    field: FloatArray
    """Raw field, tesla. Shape (m, 3)."""
    up: FloatArray
    """Body axes, unit. Shape (m, 3)."""
    rate: FloatArray
    """rad/s, body axes. Shape (m, 3)."""
    speed: FloatArray | None = None
    """m/s along the way; None where nobody measures it. Shape (m,)."""
    lean: LeanDoubt = LeanDoubt()
    """Of up."""
    wander: FloatArray | None = None
    """About what is wrong with how up varies. Shape (m, 3)."""


def levelled_axes(up: FloatArray) -> FloatArray:
    """Return rotations from body to levelled axes whose x lies under body x, shape (m, 3, 3).

    Parameters
    ----------
    up : ndarray, shape (m, 3)
        Unit vectors in body axes.
    """
    # Where body x stands upright its shadow tells nothing; what is taken there does not matter.
    left = np.cross(up, np.array([1.0, 0.0, 0.0]))
    size = np.linalg.norm(left, axis=1)
    left[size < 1e-6] = (0.0, 1.0, 0.0)
    left = unit(left)
    return np.stack([np.cross(left, up), left, up], axis=1)


def yaw_steps(time: FloatArray, rate: FloatArray, level: FloatArray) -> FloatArray:
    """Return by how much body x turned about up from each sample to the next, shape (m - 1,)."""
    vectors = 0.5 * (rate[1:] + rate[:-1]) * np.diff(time)[:, None]
    step = level[1:] @ exp_rotations(-vectors) @ np.swapaxes(level[:-1], 1, 2)
    return -turns_about_z(step)


def nodes_of(track: Track, to_body: FloatArray) -> Nodes:
    """Average a track into nodes; a robot that stands makes one node, however long it stands.

    Parameters
    ----------
    track : Track
        At least one sample.
    to_body : ndarray, shape (3, 3)
        From sensor axes to nominal body axes, `Mounting.to_body`.
    """
    time, level = track.time, levelled_axes(track.up)
    gaps = np.diff(time) > STREAMS.longest_gyro_step
    steps = np.where(gaps, 0.0, yaw_steps(time, track.rate, level))
    yaw = np.concatenate([[0.0], np.cumsum(steps)])
    field = MICROTESLA * track.field @ to_body.T
    pieces = np.concatenate([[0], np.cumsum(gaps)])
    length = max(TUNING.node, float(time[-1] - time[0]) / TUNING.most_nodes)
    block = ((time - time[0]) / length).astype(int) + pieces * (len(time) + 1)
    blocks = Means(np.flatnonzero(np.diff(block, prepend=-1)), len(time))
    limit = _still(field, blocks)
    stands = _standing(blocks.of(time), blocks.of(field), blocks.of(yaw), limit)
    stands &= pieces[blocks.first] == pieces[np.maximum(blocks.first - 1, 0)]
    way = _way(track, blocks.spread(stands.astype(float)) > 0.0)
    means = Means(blocks.first[~stands], len(time))
    middle, centre = means.of(yaw), means.of(time)
    inside = yaw - means.spread(middle)
    c, s = np.cos(inside)[:, None], np.sin(inside)[:, None]
    columns = (c * level[:, 0] - s * level[:, 1], s * level[:, 0] + c * level[:, 1], level[:, 2])
    piece = pieces[means.first]
    return Nodes(
        centre,
        means.of(field),
        means.of(np.stack(columns, axis=2)),
        np.diff(middle, prepend=middle[0]),
        np.diff(centre, prepend=centre[0]),
        np.diff(means.of(way), prepend=0.0),
        np.diff(piece, prepend=piece[0] - 1) == 0,
        replace(track.lean, wander=_wander(track, means)),
    )


def _wander(track: Track, means: Means) -> float:
    """Return which share of the square by which up varies from node to node is error of up."""
    if track.wander is None:
        return 0.0
    up = means.of(track.up)
    varies = float(np.sum((up - up.mean(axis=0)) ** 2))
    return min(float(np.sum(means.of(track.wander) ** 2)) / max(varies, 1e-9), 1.0)


class Means:
    """Means over stretches of rows that follow one another.

    Parameters
    ----------
    first : ndarray of int
        Where each stretch begins; the first at zero.
    count : int
        Number of all rows.
    """

    def __init__(self, first: IntArray, count: int) -> None:
        self.first = first
        self.sizes = np.diff(np.append(first, count))

    def of(self, values: FloatArray) -> FloatArray:
        """Return the mean of each stretch of rows (m, ...)."""
        sums = np.add.reduceat(values, self.first, axis=0)
        return np.asarray(sums / self.sizes.reshape(-1, *[1] * (values.ndim - 1)))

    def spread(self, values: FloatArray) -> FloatArray:
        """Return for each row the value of its stretch."""
        return np.repeat(values, self.sizes, axis=0)


def _still(field: FloatArray, blocks: Means) -> FloatArray:
    """Return by how much the mean fields of two blocks at rest may differ, (b, 3)."""
    if len(field) < 2:
        return np.full((1, 3), TUNING.still_field)
    noise = np.median(np.abs(np.diff(field, axis=0)), axis=0) / 0.954
    return np.asarray(TUNING.still_field + 4.0 * noise * np.sqrt(2.0 / blocks.sizes)[:, None])


def _standing(time: FloatArray, field: FloatArray, yaw: FloatArray, limit: FloatArray) -> BoolArray:
    """Return which blocks tell nothing beyond the one that began their rest."""
    stands = np.zeros(len(yaw), dtype=bool)
    begun = 0
    for k in range(1, len(yaw)):
        moved = np.abs(field[k] - field[begun]) > limit[k]
        turned = TUNING.still_yaw + TUNING.still_rate * (time[k] - time[begun])
        if moved.any() or abs(yaw[k] - yaw[begun]) > turned:
            begun = k
        else:
            stands[k] = True
    return stands


def _way(track: Track, stands: BoolArray) -> FloatArray:
    """Return the metres driven up to each sample, shape (m,)."""
    if track.speed is None:
        speed = np.where(stands, 0.0, TUNING.usual_speed)
    else:
        speed = np.abs(track.speed)
    seconds = np.minimum(np.diff(track.time), STREAMS.longest_gyro_step)
    steps = seconds * 0.5 * (speed[1:] + speed[:-1])
    return np.concatenate([[0.0], np.cumsum(steps)])
