"""When a robot moves and when it rests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.unknowns import Lengths


def level_axes(up: FloatArray) -> FloatArray:
    """Return level axes as columns, shape (..., 3, 3): x lies under body x; z is up, (..., 3)."""
    left = unit(np.cross(up, np.array([1.0, 0.0, 0.0])))
    return np.stack([np.cross(left, unit(up)), left, unit(up)], axis=-1)


@dataclass(frozen=True, eq=False)
class Course:
    """What does not change while the smoother iterates."""

    nodes: Nodes
    axes: FloatArray
    """The body's level axes: ahead, left and up in body axes, as columns. Shape (3, 3)."""
    moving: FloatArray
    """Expected share of the node in which the robot moves: one, zero at rest, and a half where it
    starts or stops. Shape (n,)."""
    edge: BoolArray
    """Whether the robot starts or stops there; the share is between zero and one then. Shape
    (n,)."""
    still: BoolArray
    """Whether the robot rests there. Shape (n,)."""
    span: FloatArray
    """Time over the window's length, its middle at zero. Shape (n,)."""

    @classmethod
    def of(cls, nodes: Nodes, axes: FloatArray, bias: FloatArray, lengths: Lengths) -> Course:
        """Find where a robot rests, given its level axes and the gyro's bias."""
        speed = np.linalg.norm(nodes.rate - bias, axis=1)
        slow = speed < lengths.moving + 0.1 * np.quantile(speed, 0.9)
        quiet = nodes.quiet & slow
        lonely = ~(np.append(quiet[1:], False) | np.insert(quiet[:-1], 0, False))
        still = quiet & ~lonely
        span = (nodes.time - nodes.time.mean()) / max(np.ptp(nodes.time), 1e-9)
        edge = ~still & (np.append(still[1:], False) | np.insert(still[:-1], 0, False))
        moving = np.where(edge, 0.5, (~still).astype(float))
        return cls(nodes, axes, moving, edge, still, span)
