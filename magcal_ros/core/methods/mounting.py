"""What gravity says about the mounting of a magnetometer whose axes were taken for aligned.

Field and gravity keep one angle in the world. A correction that is turned by a small rotation d
breaks that: u·m = c - d·(m x u) for unit vectors u up and m of the corrected field. Tumbling shows
all three components of d, turning about one axis shows none of them well. The methods for tumbled
sensors do not correct with d, but their uncertainty must hold it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.correction import PARAMETERS
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import skew

BLOCKS = 16
LEAST_VARIANCE = 1e-10
"""Of the cosine between field and gravity: keeps noise-free samples finite."""


@dataclass(frozen=True, eq=False)
class SeenMounting:
    """A rotation of the corrected field against the IMU, as far as gravity shows it."""

    cosine: float
    """Of the angle between the field and up."""
    rotation: FloatArray
    """Expectation of the rotation vector from the corrected field to the true one, radians. Shape
    (3,)."""
    covariance: FloatArray
    """Of `rotation`, rad². Shape (3, 3)."""
    scatter: float
    """Standard deviation of the cosine that is left."""

    @property
    def angle(self) -> float:
        """Radians of the whole rotation."""
        return float(np.linalg.norm(self.rotation))

    def covariance_of(self, matrix: FloatArray) -> FloatArray:
        """Return what an ignored rotation adds to a correction's covariance, shape (12, 12).

        Parameters
        ----------
        matrix : ndarray, shape (3, 3)
            A of the correction, left as it is.
        """
        moment = np.outer(self.rotation, self.rotation) + self.covariance
        turned = np.array([(skew(axis) @ matrix).ravel() for axis in np.eye(3)])
        covariance = np.zeros((PARAMETERS, PARAMETERS))
        covariance[:9, :9] = turned.T @ moment @ turned
        return covariance


def look_at_mounting(direction: FloatArray, up: FloatArray, sigma: float) -> SeenMounting:
    """Weigh what is believed about the mounting against what gravity shows.

    Parameters
    ----------
    direction : ndarray, shape (n, 3)
        Of the corrected field, unit.
    up : ndarray, shape (n, 3)
        Of gravity's counterforce, unit, at the same moments in their order.
    sigma : float
        Radians per axis that the mounting is believed to be off before looking.

    Returns
    -------
    SeenMounting
        Neighbouring samples' common errors are counted: the noise is judged by sums over pieces
        of time.
    """
    cosines = np.sum(direction * up, axis=1)
    design = np.column_stack([np.ones(len(up)), -np.cross(direction, up)])
    if sigma == 0.0:
        scatter = float(np.std(cosines))
        return SeenMounting(float(cosines.mean()), np.zeros(3), np.zeros((3, 3)), scatter)
    prior = np.diag([0.0, *np.full(3, sigma**-2)])
    answer = np.linalg.lstsq(design, cosines, rcond=None)[0]
    residual = cosines - design @ answer
    variance = max(float(np.mean(residual**2)), LEAST_VARIANCE)
    weight = 1.0 / (variance * _repetition(design, residual))
    inverse = np.linalg.inv(weight * design.T @ design + prior)
    covariance = np.asarray(inverse, dtype=np.float64)
    answer = weight * covariance @ design.T @ cosines
    return SeenMounting(float(answer[0]), answer[1:], covariance[1:, 1:], variance**0.5)


def _repetition(design: FloatArray, residual: FloatArray) -> float:
    """Return how many samples count as one, from the scores of pieces of time."""
    scores = design * residual[:, None]
    pieces = np.array([piece.sum(axis=0) for piece in np.array_split(scores, BLOCKS)])
    single = np.maximum((scores**2).sum(axis=0), 1e-300)
    return max(1.0, float(np.mean((pieces**2).sum(axis=0) / single)))
