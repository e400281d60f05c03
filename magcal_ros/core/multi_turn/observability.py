"""What an information matrix on the shared numbers shows, and what one more turn would add."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_ros.core.calibration.correction import PARAMETERS
from magcal_ros.core.calibration.heading_sigma import rms_sigma
from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.free_attitude import FreeBlock
from magcal_ros.core.estimation.information import inverse_information
from magcal_ros.core.estimation.model import Evaluation, Samples, State, about_z, predict
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.estimation.solver import Fit
from magcal_ros.core.estimation.uncertainty import correction_jacobian, heading_by_twelve
from magcal_ros.core.estimation.weighting import Noise, Weighting, Weights
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.rotations import minimal_rotation, rotation_from_rpy
from magcal_ros.core.multi_turn.result import Advice, Shown

TILT = math.radians(10.0)
CANDIDATE_SAMPLES = 120
"""Samples of an imagined turn; its noise is chosen such that they tell as much as a real one."""

Z: FloatArray = np.array([0.0, 0.0, 1.0])

SLOPES = (("east", 0.0), ("north", 0.5 * math.pi), ("west", math.pi), ("south", 1.5 * math.pi))
LEANINGS = (
    ("the nose 10° up", (0.0, -TILT)),
    ("the nose 10° down", (0.0, TILT)),
    ("the left side 10° up", (TILT, 0.0)),
    ("the right side 10° up", (-TILT, 0.0)),
)


def heading_jacobians(
    shared: Globals, mounting: FloatArray, scale: float
) -> tuple[FloatArray, FloatArray]:
    """Return the derivative of the yaw by the twelve numbers: level (24, 12), tilted (96, 12)."""
    level, tilted = (heading_by_twelve(shared, mounting, scale, tilt) for tilt in (0.0, TILT))
    return level, tilted


def relative(jacobian: FloatArray, level: FloatArray) -> FloatArray:
    """Return the Jacobian of the yaw after the level's common offset is taken off."""
    return np.asarray(jacobian - level.mean(axis=0))


def shown_by(
    information: FloatArray, free: IntArray, shared: Globals, mounting: FloatArray, scale: float
) -> Shown:
    """Say what is shown.

    Parameters
    ----------
    information : ndarray, shape (s, s)
        On the shared numbers `free`, priors included.
    free : ndarray of int, shape (s,)
    shared : Globals
        Where.
    mounting : ndarray, shape (3, 3)
    scale : float
        Tesla of one field scale.
    """
    covariance = np.zeros((p.COUNT, p.COUNT))
    covariance[np.ix_(free, free)] = inverse_information(information)
    by_global = correction_jacobian(shared, mounting, scale)
    twelve = by_global @ covariance @ by_global.T
    level, tilted = heading_jacobians(shared, mounting, scale)
    axial = np.zeros(PARAMETERS)
    axial[9:] = np.linalg.solve(mounting, np.eye(3))[2]
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return Shown(
        installation_yaw=float(sigma[p.YAW]),
        soft_iron=tuple(float(value) for value in sigma[p.SOFT_IRON]),
        axial_hard_iron=math.sqrt(max(float(axial @ twelve @ axial), 0.0)),
        strength=scale * float(sigma[p.STRENGTH]),
        inclination=float(sigma[p.INCLINATION]),
        level=rms_sigma(relative(level, level), twelve),
        tilted=rms_sigma(relative(tilted, level), twelve),
        absolute_level=rms_sigma(level, twelve),
        absolute_tilted=rms_sigma(tilted, twelve),
    )


def advise(joint: Fit, scale: float) -> tuple[Advice, ...]:
    """Return further turns, the one first that leaves the smallest absolute heading error.

    Each is imagined as a full turn with the usual noise and number of samples; its expected
    information at the present estimate is added to what is there.
    """
    mounting = joint.mounting

    def after(added: FloatArray) -> Shown:
        total = joint.information + added
        return shown_by(total, joint.free, joint.shared, mounting, scale)

    imagined = [Advice(pose, after(imagined_information(joint, *axes))) for pose, *axes in _poses()]
    return tuple(sorted(imagined, key=lambda advice: advice.after.absolute_tilted))


def _poses() -> list[tuple[str, FloatArray, FloatArray]]:
    """Return what to do, and the turn's axis in the body and in the world."""
    poses = [("on the level once more", Z, Z)]
    for name, azimuth in SLOPES:
        lean = math.sin(TILT)
        normal = [-lean * math.cos(azimuth), -lean * math.sin(azimuth), math.cos(TILT)]
        poses.append((f"on a slope of 10° that rises to the {name}", Z, np.array(normal)))
    for name, (roll, pitch) in LEANINGS:
        poses.append((f"about the vertical with {name}", rotation_from_rpy(roll, pitch).T @ Z, Z))
    return poses


def imagined_information(joint: Fit, body: FloatArray, world: FloatArray) -> FloatArray:
    """Return what a full turn about an axis is expected to say of the shared numbers, (s, s)."""
    shared = replace(
        joint.shared,
        body_axis=minimal_rotation(Z, body),
        world_axis=minimal_rotation(Z, world),
    )
    n = CANDIDATE_SAMPLES
    state = State(shared, about_z(np.linspace(0.0, math.tau, n, endpoint=False)))
    mounting = joint.mounting
    said = predict(state, Samples(np.zeros((n, 3)), np.zeros((n, 3)), mounting))
    samples = Samples(-said.up_residual @ shared.body_axis.T, -said.field_residual, mounting)
    weighting = Weighting(_usual_noise(joint), Weights.ones(n))
    imagined = FreeBlock(Evaluation(state, samples), weighting, leans=False)
    return joint.with_blocks([imagined]).turn_information[0]


def _usual_noise(joint: Fit) -> Noise:
    """Return noise with which so few samples tell as much as a turn of those that are there."""

    def usual(values: list[float]) -> float:
        return float(np.sqrt(CANDIDATE_SAMPLES * np.median(values)))

    weightings = [block.weighting for block in joint.blocks]
    each = [(w.noise, w.inefficiency / max(float(w.inliers.sum()), 1.0)) for w in weightings]
    return Noise(
        usual([noise.up**2 * share for noise, share in each]),
        usual([noise.field**2 * share for noise, share in each]),
        1.0,
    )
