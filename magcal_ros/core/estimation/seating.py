"""Where each sample's attitude lies when the shared numbers are given."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_ros.core.estimation.model import Samples, State
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray
from magcal_ros.core.geometry.attitude import body_from_enu
from magcal_ros.core.geometry.rotations import minimal_rotation

UP: FloatArray = np.array([0.0, 0.0, 1.0])
SHORTEST_ARC_MEAN = 0.95
"""Second singular value of the mean attitude, sin(a/2)/(a/2) of an arc a: about 63 degrees."""


def attitudes_from_vectors(shared: Globals, samples: Samples) -> FloatArray:
    """Return the attitudes that up and corrected field show, shape (n, 3, 3)."""
    matrix = np.linalg.inv(shared.distortion(samples.mounting))
    field = (samples.field - shared.hard_iron) @ matrix.T
    body = body_from_enu(samples.up, field)
    return np.asarray(shared.body_axis.T @ body @ shared.world_axis)


def seated(shared: Globals, samples: Samples, inliers: BoolArray) -> State:
    """Return the shared numbers with the axes that the inliers show, and all attitudes."""
    if inliers.sum() < 3:
        inliers = np.ones(len(samples), dtype=np.bool_)
    plain = replace(shared, body_axis=np.eye(3), world_axis=np.eye(3))
    body, world = _common_axis(attitudes_from_vectors(plain, samples.take(inliers)))
    found = replace(
        shared, body_axis=minimal_rotation(UP, body), world_axis=minimal_rotation(UP, world)
    )
    return State(found, attitudes_from_vectors(found, samples))


def _common_axis(attitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the axis about which attitudes (n, 3, 3) turn, in body and in world axes.

    For an axis b in the body that is w in the world `R_i w = b` for all i: with the mean of the
    attitudes M, w and b are its singular vectors whose singular value is one. On a short arc all
    three are near one, and the body's own z serves.
    """
    left, values, right = np.linalg.svd(attitude.mean(axis=0))
    body, world = left[:, 0], right[0]
    if values[1] > SHORTEST_ARC_MEAN:
        body = UP
        world = (np.swapaxes(attitude, 1, 2) @ body).mean(axis=0)
        world = world / np.linalg.norm(world)
    sense = math.copysign(1.0, float(body[2]))
    return sense * body, sense * world
