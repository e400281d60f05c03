"""A value of all unknowns, and where the robot rests."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.rotations import exp_rotations, rotation_about
from magcal_ros.core.knowledge import Z
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.unknowns import AT, ATTITUDE, EARTH, SHARED, STREET, Lengths

SECTORS = 12  # of heading


@dataclass(frozen=True, eq=False)
class State:
    """A value of all unknowns."""

    attitude: FloatArray  # magnetic ENU to body axes. Shape (n, 3, 3).
    local: FloatArray
    """The nodes' other unknowns; the attitude's columns are zero. Shape (n, LOCAL)."""
    shared: FloatArray  # Shape (SHARED,)
    centres: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    """Local disturbance at the centres of `Places`, µT, world axes. Shape (k, 3)."""

    def moved(self, local: FloatArray, shared: FloatArray) -> State:
        """Return the state after a step; `shared` holds the steps of the centres at its end."""
        turned = exp_rotations(local[:, ATTITUDE]) @ self.attitude
        values = self.local + local
        values[:, ATTITUDE] = 0.0
        centres = self.centres + shared[SHARED:].reshape(-1, 3)
        return State(turned, values, self.shared + shared[:SHARED], centres)

    @property
    def vehicle_axes(self) -> FloatArray:
        """The vehicle's axes at the nodes: ahead, left and up in body axes, as columns, (n, 3, 3).

        Up is the world's: the first two are level, however the body sways.
        """
        return self._axes(self.attitude[:, :, 2])

    @property
    def mean_axes(self) -> FloatArray:
        """The same by the mean direction of up, shape (3, 3)."""
        return self._axes(np.median(self.attitude[:, :, 2], axis=0))

    def _axes(self, up: FloatArray) -> FloatArray:
        forward = rotation_about(Z, self.shared[AT["mounting_yaw"]])[0]
        return np.asarray(level_axes(up) @ forward)

    @property
    def is_backward(self) -> bool:
        """Whether the level field points south: all headings are then off by half a turn."""
        return bool(self.shared[EARTH][0] < 0.0)

    def turned_about(self) -> State:
        """Return the same state with the world's axes turned by half a turn about up.

        Field, gravity and gyro are explained equally well. Not for a turn without a gyro: its
        nodes have other unknowns.
        """
        about = np.array([-1.0, -1.0, 1.0])
        values, shared = self.local.copy(), self.shared.copy()
        values[:, STREET] *= about
        shared[EARTH] *= [-1.0, 1.0]
        return State(self.attitude * about, values, shared, self.centres * about)

    @property
    def yaw(self) -> FloatArray:
        """Heading of body x to magnetic north, ENU, radians, shape (n,)."""
        return np.asarray(np.arctan2(self.attitude[:, 0, 1], self.attitude[:, 0, 0]))

    @property
    def sector(self) -> IntArray:
        """Sector of heading, 0 to `SECTORS` - 1, shape (n,)."""
        share = np.mod(self.yaw, math.tau) / (math.tau / SECTORS)
        return np.asarray(share.astype(np.int64) % SECTORS)

    @property
    def earth(self) -> FloatArray:
        """The Earth's field in magnetic ENU, µT."""
        level, down = self.shared[EARTH]
        return np.array([0.0, level, -down])


def damped(seconds: FloatArray, damping: float, pace: float) -> FloatArray:
    """Return exp(A t) for A = [[0, 1], [-pace^2, -damping]], shape (2, 2, n).

    This is the transition matrix of a value and its rate of change over `seconds` (n,): the rate is
    damped, and the value is drawn back to zero.
    """
    root = np.sqrt(complex(0.25 * damping**2 - pace**2))
    root = root if abs(root) > 1e-6 else complex(1e-6)
    fades = np.exp(-0.5 * damping * seconds)
    even = np.real(fades * np.cosh(root * seconds))
    odd = np.real(fades * np.sinh(root * seconds) / root)
    half = 0.5 * damping * odd
    return np.array([[even + half, odd], [-(pace**2) * odd, even - half]])


def level_axes(up: FloatArray) -> FloatArray:
    """Return level axes as columns, shape (..., 3, 3): x lies under body x; z is up, (..., 3)."""
    left = unit(np.cross(up, np.array([1.0, 0.0, 0.0])))
    return np.stack([np.cross(left, unit(up)), left, unit(up)], axis=-1)


@dataclass(frozen=True, eq=False)
class Course:
    """Rests and motion at the nodes."""

    nodes: Nodes
    axes: FloatArray
    """The body's level axes: ahead, left and up in body axes, as columns. Shape (3, 3)."""
    still: BoolArray  # whether the robot rests in the node. Shape (n,).

    @classmethod
    def of(cls, nodes: Nodes, axes: FloatArray, bias: FloatArray, lengths: Lengths) -> Course:
        """Return the course: where a robot rests, given its level axes and the gyro's bias."""
        speed = np.linalg.norm(nodes.rate - bias, axis=1)
        slow = speed < lengths.moving + 0.1 * np.quantile(speed, 0.9)
        quiet = nodes.quiet & slow
        return cls(nodes, axes, quiet & _beside(quiet))

    @cached_property
    def edge(self) -> BoolArray:
        """Whether the robot starts or stops in the node, shape (n,)."""
        return ~self.still & _beside(self.still)

    @cached_property
    def moving(self) -> FloatArray:
        """Expected fraction of the node in which the robot moves, shape (n,).

        One, zero at rest, and a half in a node in which the robot starts or stops.
        """
        return np.where(self.edge, 0.5, (~self.still).astype(float))


def _beside(flags: BoolArray) -> BoolArray:
    """Return which elements (n,) have a neighbour with a flag."""
    return np.append(flags[1:], False) | np.insert(flags[:-1], 0, False)
