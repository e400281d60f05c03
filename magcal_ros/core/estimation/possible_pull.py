"""Linear acceleration of a turn that nothing shows (doc/estimator.md, section 10).

The mean axis by the gyro shows a linear acceleration only as well as the gyro's bias is known.
Without a gyro only vibration shows that a robot drives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.estimation.block import TurnBlock
from magcal_ros.core.estimation.gyro_path import BIAS, GyroPath
from magcal_ros.core.estimation.linear_acceleration import ACCELERATION
from magcal_ros.core.estimation.model import Samples
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit
from magcal_ros.core.geometry.rotations import skew
from magcal_ros.core.up.up_tuning import FilterTuning


@dataclass(frozen=True)
class Leaning:
    """How far the mean specific force leans from the gyro's up, radians.

    Parameters
    ----------
    apart : float
        Where a usual bias of the gyro explains its share.
    at_most : float
        Where what was taken for a bias is a pull as well, as far as the turn leaves that open.
    """

    apart: float
    at_most: float


def leaning(samples: Samples, path: GyroPath) -> Leaning:
    """Return how far the mean specific force leans from the gyro's up.

    Up that stands still in the world, a lean that turns with the robot, and the gyro's bias are
    told apart, so that neither a slope nor part of a second turn counts, nor a pause.

    Parameters
    ----------
    samples : Samples
    path : GyroPath
        Of the same samples.
    """
    forth = path.relative
    still = unit(np.einsum("nji,nj->i", forth, samples.up))
    by_bias = -forth @ skew(still) @ path.basis[:, :, BIAS]
    rows = np.concatenate(
        [forth, by_bias, np.broadcast_to(np.eye(3), forth.shape)], axis=2
    ).reshape(-1, 9)
    # One jolt is one witness, however many samples it is seen in.
    seconds = path.knots * path.spacing
    weight = seconds / ACCELERATION.jolt / len(samples) / ACCELERATION.own_lean**2
    known = np.repeat([0.0, path.known.bias**-2, path.known.acceleration**-2], 3)
    covariance = np.linalg.inv(weight * rows.T @ rows + np.diag(known))
    found = covariance @ (weight * rows.T @ samples.up.ravel())
    unseen = covariance[3:6, 3:6] @ found[3:6] / path.known.bias**2
    leans = [found[6:], found[6:] + by_bias.mean(axis=0) @ unseen]
    across = [float(np.linalg.norm(lean - still * (lean @ still))) for lean in leans]
    return Leaning(math.atan(across[0]), math.atan(max(across)))


def doubtful_pull(lean: float, rate: float, lever_arm: float) -> float:
    """Return how far up may be pulled without a trace, radians per axis, one sigma.

    A robot that drives a small circle instead of turning on the spot is pulled all the way, and
    gyros have biases that look the same.

    Parameters
    ----------
    lean : float
        Radians, at most (`Leaning`).
    rate : float
        Of the turn, rad/s, RMS.
    lever_arm : float
        Metres, one sigma: what it explains is counted elsewhere.
    """
    metre = rate**2 / STANDARD_GRAVITY
    pull = min(lean, ACCELERATION.largest_circle * metre)
    beyond = max(0.0, pull - ACCELERATION.arms * lever_arm * metre)
    return math.sqrt(ACCELERATION.least_doubt) * beyond


def jolts_without_gyro(block: TurnBlock, seconds: float) -> float:
    """Return what is left of up over `ACCELERATION.jolt` seconds: correlation is no vibration.

    Parameters
    ----------
    block : TurnBlock
    seconds : float
        How long the turn took.
    """
    independent = len(block.samples) / block.weighting.inefficiency
    return block.weighting.noise.up * math.sqrt(seconds / ACCELERATION.jolt / independent)


def pull_without_gyro(jolted: float, rate: float) -> float:
    """Return how far up may be pulled where no gyro tells, radians per axis, one sigma.

    A vehicle on a circle is pulled to one side all the way, which looks like a roll of the
    installation. Who turns on the spot is hardly jolted; who drives is.

    Parameters
    ----------
    jolted : float
        What is left of up over a second (`jolts_without_gyro`), radians.
    rate : float
        Of the turn, rad/s, RMS.
    """
    driven = ACCELERATION.jolted_alone * max(0.0, jolted - ACCELERATION.on_the_spot)
    fastest = FilterTuning().usual_speed * rate / STANDARD_GRAVITY
    return math.sqrt(ACCELERATION.least_doubt) * min(driven, fastest)


def lever_arm_left(lean: float, rate: float, lever_arm: float, bias: float) -> float:
    """Return how large a lever arm the gyro's axis leaves possible, metres, one sigma.

    The lean from the gyro's axis is the sum of what the lever arm pulls, what a bias of the gyro
    feigns, and what the accelerometer leans by itself; of a fast turn it is the first alone.

    Parameters
    ----------
    lean : float
        Radians (`Leaning`).
    rate : float
        Of the turn, rad/s, RMS.
    lever_arm, bias : float
        Metres and rad/s, one sigma: what is believed before.
    """
    metre = rate**2 / STANDARD_GRAVITY
    pulled, other = lever_arm * metre, math.hypot(ACCELERATION.own_lean, bias / max(rate, 1e-3))
    share = pulled**2 / (pulled**2 + other**2)
    return min(lever_arm, math.hypot(share * lean, math.sqrt(share) * other) / max(metre, 1e-9))
