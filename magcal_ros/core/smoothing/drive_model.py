"""The smoother's model: what all nodes share, and the field that each of them should read.

Units inside: microtesla, radians, seconds, metres. A node reads `h + D W Rz(psi)^T (B + d)` with
D = (I + E) R, the house's model of `Knowledge` in nominal body axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import rotation_from_rpy, skew
from magcal_ros.core.smoothing.nodes import Nodes

IRON, ROLL, PITCH, SOFT = slice(0, 3), 3, 4, slice(5, 10)
LEVEL_FIELD, DOWN_FIELD, GYRO_BIAS, GYRO_SCALE = 10, 11, 12, 13
SHARED = 14
"""How many numbers all nodes share, and where they stand in their vector."""

SOFT_BASIS: FloatArray = np.array(
    [
        np.diag([1.0, -1.0, 0.0]),
        [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
        np.diag([-0.5, -0.5, 1.0]),
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]],
    ]
)
"""Symmetric and without a trace: a gain of all axes is a strength of the field, and left free it
would shrink with the disturbances to nothing."""

ALONG_X: FloatArray = np.array([1.0, 0.0, 0.0])
ALONG_Y: FloatArray = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Everything that is sought."""

    shared: FloatArray
    """Hard iron (3, nominal body axes), installation roll and pitch, soft iron (5), level and
    downward field, the gyro's bias and scale. Shape (14,)."""
    yaw: FloatArray
    """Of each node, to magnetic north. Shape (n,)."""
    street: FloatArray
    """The disturbance there, magnetic ENU. Shape (n, 3)."""

    def moved(self, shared: FloatArray, local: FloatArray) -> Unknowns:
        """Return what a step in the shared numbers (14,) and in yaw and street (n, 4) leads to."""
        return replace(
            self,
            shared=self.shared + shared,
            yaw=self.yaw + local[:, 0],
            street=self.street + local[:, 1:],
        )

    @property
    def distortion(self) -> FloatArray:
        """D, shape (3, 3)."""
        return distortion(self.shared)

    @property
    def earth(self) -> FloatArray:
        """B in magnetic ENU, microtesla, shape (3,)."""
        return np.array([0.0, self.shared[LEVEL_FIELD], -self.shared[DOWN_FIELD]])


def distortion(shared: FloatArray) -> FloatArray:
    """Return D of the shared numbers, shape (3, 3)."""
    turned = rotation_from_rpy(shared[ROLL], shared[PITCH]).T
    return np.asarray((np.eye(3) + _soft(shared)) @ turned, dtype=np.float64)


def _soft(shared: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("k,kij->ij", shared[SOFT], SOFT_BASIS), dtype=np.float64)


def turned_into(yaw: FloatArray) -> FloatArray:
    """Return Rz(yaw)^T, from magnetic ENU to levelled axes, shape (n, 3, 3)."""
    out = np.zeros((len(yaw), 3, 3))
    c, s = np.cos(yaw), np.sin(yaw)
    out[:, 0, 0], out[:, 0, 1], out[:, 1, 0], out[:, 1, 1] = c, s, -s, c
    out[:, 2, 2] = 1.0
    return out


def field_of(nodes: Nodes, unknowns: Unknowns) -> FloatArray:
    """Return the field that the nodes should read, shape (n, 3)."""
    inside = np.einsum("nij,nj->ni", turned_into(unknowns.yaw), unknowns.earth + unknowns.street)
    body = np.einsum("nij,nj->ni", nodes.axes, inside)
    iron = np.outer(nodes.has_iron, unknowns.shared[IRON])
    return np.asarray(body @ unknowns.distortion.T + iron)


def field_jacobians(nodes: Nodes, unknowns: Unknowns) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of `field_of` by yaw and street (n, 3, 4) and shared (n, 3, 14)."""
    shared, n = unknowns.shared, len(nodes)
    into = turned_into(unknowns.yaw)
    inside = np.einsum("nij,nj->ni", into, unknowns.earth + unknowns.street)
    body = np.einsum("nij,nj->ni", nodes.axes, inside)
    soft = np.eye(3) + _soft(shared)
    turned = rotation_from_rpy(shared[ROLL], shared[PITCH]).T
    whole = soft @ turned
    by_level = whole @ nodes.axes
    by_world = by_level @ into
    local = np.empty((n, 3, 4))
    # Rz(psi)^T v turns its level part by minus psi.
    swung = np.stack([inside[:, 1], -inside[:, 0], np.zeros(n)], axis=1)
    local[:, :, 0] = np.einsum("nij,nj->ni", by_level, swung)
    local[:, :, 1:] = by_world
    every = np.zeros((n, 3, SHARED))
    every[:, :, IRON] = nodes.has_iron[:, None, None] * np.eye(3)
    pitched = rotation_from_rpy(0.0, shared[PITCH]).T
    rolled = rotation_from_rpy(shared[ROLL], 0.0).T
    every[:, :, ROLL] = body @ (soft @ -skew(ALONG_X) @ turned).T
    every[:, :, PITCH] = body @ (soft @ rolled @ -skew(ALONG_Y) @ pitched).T
    every[:, :, SOFT] = np.einsum("kij,nj->nik", SOFT_BASIS, body @ turned.T)
    every[:, :, LEVEL_FIELD] = by_world[:, :, 1]
    every[:, :, DOWN_FIELD] = -by_world[:, :, 2]
    return local, every


def gyro_residual(nodes: Nodes, unknowns: Unknowns) -> FloatArray:
    """Return yaw less the gyro's from node to node, shape (n - 1,), radians."""
    bias, scale = unknowns.shared[GYRO_BIAS], unknowns.shared[GYRO_SCALE]
    believed = (1.0 + scale) * nodes.turned[1:] - bias * nodes.seconds[1:]
    return np.asarray(np.diff(unknowns.yaw) - believed)
