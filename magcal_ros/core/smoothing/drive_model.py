"""The smoother's model and priors: what nodes share, and the field that each should read.

Units inside: microtesla, radians, seconds, metres. A node reads `h + D W Rz(psi)^T (B + d)` with
D = (I + E) R, the house's model of `Knowledge` in nominal body axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import rotation_from_rpy, skew
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoothing.nodes import MICROTESLA, Nodes
from magcal_ros.core.smoothing.tuning import TUNING, SmootherTuning

TYPICAL_STRENGTH = 50e-6
"""Tesla, where nobody knows the strength."""
HELD = 1e-6
"""Sigma of a number that is held, in its own unit."""


@dataclass(frozen=True, eq=False)
class SharedPrior:
    """A Gaussian on the shared numbers."""

    mean: FloatArray
    """Shape (15,)."""
    covariance: FloatArray
    """Shape (15, 15)."""

    @property
    def information(self) -> FloatArray:
        """Its inverse, shape (15, 15)."""
        return np.asarray(np.linalg.inv(self.covariance))

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations, shape (15,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def about(self, iron: FloatArray) -> SharedPrior:
        """Return the same with another hard iron for its middle."""
        mean = self.mean.copy()
        mean[IRON] = iron
        return replace(self, mean=mean)

    def widened(self, shared: FloatArray, tuning: SmootherTuning = TUNING) -> SharedPrior:
        """Return the same with what was found far beyond its sigma as wide as that.

        Of soft iron the other numbers follow; the gyro's bias is one of its own.
        """
        sigma = self.sigma
        is_far = np.abs(shared) > tuning.far_beyond * sigma
        found = np.abs(shared[SOFT])
        if is_far[SOFT].any():
            largest = float(found[is_far[SOFT]].max())
            wider = np.where(is_far[SOFT], found, tuning.shared_soft_iron * largest)
            sigma[SOFT] = np.maximum(sigma[SOFT], np.minimum(wider, tuning.widest_soft_iron))
        if is_far[GYRO_BIAS]:
            sigma[GYRO_BIAS] = abs(float(shared[GYRO_BIAS]))
        covariance = self.covariance.copy()
        rows = [*range(SHARED)[SOFT], GYRO_BIAS]
        covariance[rows, rows] = sigma[rows] ** 2
        return replace(self, covariance=covariance)


def free_prior(knowledge: Knowledge, tuning: SmootherTuning = TUNING) -> SharedPrior:
    """Return the prior of a sensor of which little is known."""
    mean, sigma = np.zeros((2, SHARED))
    counts = math.sqrt(tuning.counts)
    sigma[IRON] = tuning.hard_iron
    sigma[[ROLL, PITCH]] = tuning.tilt / counts
    sigma[SOFT] = np.array([tuning.soft_iron] * 2 + [tuning.soft_iron_upright] * 3) / counts
    iron = knowledge.soft_iron
    if iron.sigma_diagonal == 0.0 and iron.sigma_cross == 0.0:
        sigma[SOFT] = HELD
    sigma[GYRO_BIAS], sigma[GYRO_SCALE] = tuning.gyro_bias, tuning.gyro_scale
    sigma[OFFSET] = tuning.course_offset
    covariance = np.diag(sigma**2)
    earth, spread = _earth(knowledge, tuning)
    rows = np.ix_([LEVEL_FIELD, DOWN_FIELD], [LEVEL_FIELD, DOWN_FIELD])
    mean[[LEVEL_FIELD, DOWN_FIELD]] = earth
    # The sensor's own gain moves both alike.
    covariance[rows] = spread / tuning.counts + tuning.gain**2 * np.outer(earth, earth)
    return SharedPrior(mean, covariance)


def _earth(knowledge: Knowledge, tuning: SmootherTuning) -> tuple[FloatArray, FloatArray]:
    """Return level and downward field, microtesla, and their covariance."""
    strength, dip = knowledge.reference.strength, knowledge.reference.inclination
    size = MICROTESLA * (TYPICAL_STRENGTH if strength.is_unknown else strength.value)
    angle = tuning.typical_dip if dip.is_unknown else dip.value
    earth = size * np.array([math.cos(angle), math.sin(angle)])
    along, across = earth / size, np.array([-earth[1], earth[0]])
    spread = np.diag(np.square(tuning.strength))
    if strength.is_unknown:
        spread += tuning.counts * np.outer(along, along) * (tuning.unknown_strength * size) ** 2
    elif strength.sigma > 0.0:
        spread += np.outer(along, along) * (MICROTESLA * strength.sigma) ** 2
    if dip.is_unknown:
        spread += tuning.counts * np.outer(across, across) * tuning.unknown_dip**2
    elif dip.sigma > 0.0:
        spread += np.outer(across, across) * dip.sigma**2
    return earth, spread


def held_prior(
    prior: SharedPrior, *, iron: bool, tilt: float = HELD, soft_iron: float = HELD
) -> SharedPrior:
    """Return the prior for a field to which a calibration was applied already.

    Parameters
    ----------
    prior : SharedPrior
        Of field and gyro.
    iron : bool
        Whether a change of the hard iron is free.
    tilt, soft_iron : float
        Sigmas of what else may have changed: radians, relative.
    """
    mean, covariance = prior.mean.copy(), prior.covariance.copy()
    mean[: SOFT.stop] = 0.0
    sigma = np.full(SOFT.stop, soft_iron)
    sigma[IRON] = prior.sigma[IRON] if iron else HELD
    sigma[[ROLL, PITCH]] = tilt
    covariance[: SOFT.stop, : SOFT.stop] = np.diag(sigma**2)
    return SharedPrior(mean, covariance)


IRON, ROLL, PITCH, SOFT = slice(0, 3), 3, 4, slice(5, 10)
LEVEL_FIELD, DOWN_FIELD, GYRO_BIAS, GYRO_SCALE, OFFSET = 10, 11, 12, 13, 14
SHARED = 15
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
    downward field, the gyro's bias and scale, compass less course. Shape (15,)."""
    yaw: FloatArray
    """Of each node, to magnetic north. Shape (n,)."""
    street: FloatArray
    """The disturbance there, magnetic ENU. Shape (n, 3)."""

    def moved(self, shared: FloatArray, local: FloatArray) -> Unknowns:
        """Return what a step in the shared numbers (15,) and in yaw and street (n, 4) leads to."""
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
    """Return the derivatives of `field_of` by yaw and street (n, 3, 4) and shared (n, 3, 15)."""
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
