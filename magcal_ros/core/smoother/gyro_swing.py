"""The swing of the corrected compass against the gyro over a turn.

In a distorted room the field of a turn may still be a clean circle, and only the gyro shows the
distortion. Noise of single samples and errors of the gyro's bias and scale are subtracted, so that
the persistent deviation remains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.calibration import GyroSwing
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import turns_about_z


@dataclass(frozen=True)
class SwingTuning:
    """How errors of the gyro are separated from a swing of the compass."""

    sector: float = math.radians(12.0)  # radians of the turn over which the deviation is averaged
    bias: float = 0.003
    scale: float = 0.01
    """Usual errors of gyros (rad/s and ratio). A larger slope is subtracted only if it explains
    nearly all of the deviation: a swing once per turn is partly a slope, too."""
    rounds: int = 10  # iterations of the Cauchy weights
    spike: float = 6.0  # multiples of the median deviation beyond which a sector is an outlier


SWING = SwingTuning()


def gyro_compass_swing(relative: FloatArray, attitude: FloatArray, time: FloatArray) -> GyroSwing:
    """Return the persistent deviation of the compass from the gyro by sectors of heading.

    `relative` (n, 3, 3) are the rotations from the first sample's body axes to each sample's by the
    gyro. `attitude` (n, 3, 3) are the body axes from ENU axes by up and corrected field, `time`
    (n,) is in seconds.
    """
    back = np.swapaxes(relative, 1, 2)
    off = back @ attitude
    deviation = np.unwrap(turns_about_z(off @ off[len(off) // 2].T))
    turned = np.unwrap(turns_about_z(back))
    noise = _sample_noise(deviation)
    yaw = np.arctan2(attitude[:, 0, 1], attitude[:, 0, 0])
    values = np.stack([deviation, turned, time, np.sin(yaw), np.cos(yaw)])
    (away, angle, moment, sine, cosine), count = _sector_means(values, noise)
    left = without_gyro_errors(away, moment, angle)
    kept = np.abs(left) <= SWING.spike * np.median(np.abs(left)) + noise
    lasting = np.mean(left[kept] ** 2) - np.mean(noise**2 / count[kept])
    heading = np.arctan2(sine, cosine)
    return GyroSwing(heading[kept], left[kept], math.sqrt(max(float(lasting), 0.0)))


def _sample_noise(deviation: FloatArray) -> float:
    """Return the noise of single samples, radians, from second differences."""
    bend = np.diff(deviation, 2)
    return 1.4826 * float(np.median(np.abs(bend))) / math.sqrt(6.0) if len(bend) else 0.0


def _sector_means(values: FloatArray, noise: float) -> tuple[FloatArray, FloatArray]:
    """Return the means of values (m, n) over sectors of the turn, and the number of samples.

    The first row is the deviation, whose outliers are left out, the second the turned angle.
    Shapes (m, s) and (s,).
    """
    deviation, turned = values[:2]
    index = np.unique(np.floor(turned / SWING.sector), return_inverse=True)[1]
    size = int(index.max()) + 1
    middle = np.array([np.median(deviation[index == sector]) for sector in range(size)])
    good = np.abs(deviation - middle[index]) <= 4.0 * noise + 1e-6
    good |= (np.bincount(index, good, size) == 0.0)[index]
    count = np.bincount(index, good, size).astype(float)
    return np.array([np.bincount(index, good * each, size) for each in values]) / count, count


def without_gyro_errors(
    deviation: FloatArray, time: FloatArray, turned: FloatArray, alike: float = 1.0
) -> FloatArray:
    """Return a deviation (n,) without offset, bias and scale of the gyro, radians.

    `time` (n,) is in seconds, `turned` (n,) the angle by the gyro, radians. `alike` neighbours have
    the same error.
    """
    rows = np.column_stack([np.ones_like(time), time - time.mean(), turned - turned.mean()])
    prior = alike * np.diag([0.0, SWING.bias**-2, SWING.scale**-2])
    left = deviation - np.median(deviation)
    for _ in range(SWING.rounds):
        scale = float(np.median(np.abs(left))) + 1e-9
        weight = 1.0 / (1.0 + (left / (3.0 * scale)) ** 2)
        spread = float(np.sum(weight * left**2) / np.sum(weight)) + 1e-12
        weighted = rows.T * weight / spread
        found = np.linalg.solve(weighted @ rows + prior, weighted @ deviation)
        left = deviation - rows @ found
    return np.asarray(left)
