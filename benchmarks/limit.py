"""The Cramér-Rao limit: no unbiased estimator can do better on these samples.

Fisher information at the truth for sensors that are exact but for noise, with the estimator's
priors of the field, carried to the covariance of the twelve numbers and to the heading.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import shared_cases  # noqa: F401
from simulated.turns import Motion

from magcal_ros.core.calibration.calibration import yaw_jacobian
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.core.geometry.rotations import exp_rotations, minimal_rotation, rotation_from_rpy
from magcal_ros.core.knowledge import Belief, Knowledge
from magcal_ros.core.simulation import LEVEL_TILT, UP_ENU, Robot, trial_attitudes

GYRO_SCALE_SIGMA = 0.02
SOFT_IRON_ROWS = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
"""Where E holds its six numbers."""
YAW, STRENGTH, DIP, SOFT_IRON = 2, 6, 7, slice(8, 14)
"""Among the shared parameters: roll, pitch, yaw, hard iron over the strength (3), relative
strength, inclination, soft iron (6)."""
STEP = 1e-6


@dataclass(frozen=True, eq=False)
class Scene:
    """One turn of one robot: everything the limit depends on."""

    robot: Robot
    motion: Motion
    axis: FloatArray
    start_rpy: tuple[float, float, float]
    wobble: float


def covariance_limit(
    scenes: Sequence[Scene],
    knowledge: Knowledge,
    *,
    soft_iron: bool = False,
    gyro: bool = False,
    yaw: bool = False,
) -> FloatArray:
    """Return the smallest covariance of the twelve numbers, shape (12, 12).

    Parameters
    ----------
    scenes : sequence of Scene
        Turns of one robot.
    knowledge : Knowledge
    soft_iron, gyro, yaw : bool
        Whether soft iron is unknown, a gyro is used, and the installation's yaw is unknown.
    """
    robot = scenes[0].robot
    prior = _prior(knowledge, robot, soft_iron=soft_iron, yaw=yaw)
    free = np.flatnonzero(np.isfinite(prior))
    information = np.diag(prior[free])
    for scene in scenes:
        information += _information(scene, free, gyro=gyro)
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, 1e-12 * values[-1])

    def numbers(which: int, by: float) -> FloatArray:
        return _moved(robot, which, by).true_correction.parameters

    jacobian = np.stack([_slope(partial(numbers, int(k))) for k in free], axis=1)
    by_free = jacobian @ vectors
    return np.asarray((by_free / values) @ by_free.T)


def _prior(knowledge: Knowledge, robot: Robot, *, soft_iron: bool, yaw: bool) -> FloatArray:
    """Return the prior information on the shared parameters; infinite if they are known."""
    reference, assumed = knowledge.reference, knowledge.soft_iron

    def of(belief: Belief, unit: float) -> float:
        if belief.is_unknown:
            return 0.0
        return (belief.sigma / unit) ** -2.0 if belief.sigma > 0.0 else math.inf

    out = np.zeros(14)
    out[YAW] = knowledge.mounting.yaw_sigma**-2.0 if yaw else math.inf
    out[STRENGTH] = of(reference.strength, robot.strength)
    out[DIP] = of(reference.inclination, 1.0)
    sigma = np.repeat([assumed.sigma_diagonal, assumed.sigma_cross], 3)
    out[SOFT_IRON] = sigma**-2.0 if soft_iron else math.inf
    return out


def _moved(robot: Robot, which: int, by: float) -> Robot:
    """Return the robot with one of its shared parameters changed."""
    change = np.zeros(14)
    change[which] = by
    iron = np.zeros((3, 3))
    iron[SOFT_IRON_ROWS] = change[SOFT_IRON]
    return replace(
        robot,
        roll=robot.roll + change[0],
        pitch=robot.pitch + change[1],
        yaw=robot.yaw + change[YAW],
        hard_iron=robot.hard_iron + robot.strength * change[3:6],
        strength=robot.strength * (1.0 + change[STRENGTH]),
        inclination=robot.inclination + change[DIP],
        soft_iron=robot.soft_iron + iron + np.triu(iron, 1).T,
    )


def _slope(of: Callable[[float], FloatArray]) -> FloatArray:
    """Return a derivative at zero by central differences."""
    return np.asarray((of(STEP) - of(-STEP)) / (2.0 * STEP))


def _information(scene: Scene, free: IntArray, *, gyro: bool) -> FloatArray:
    """Return the information of a turn on the free shared parameters, without attitudes."""
    robot, attitude = scene.robot, scene.motion.attitude
    noise = np.repeat([robot.noise_force / STANDARD_GRAVITY, robot.noise_field], 3)

    def measured(body: FloatArray, which: int = 0, by: float = 0.0) -> FloatArray:
        other = _moved(robot, which, by)
        field = other.raw_field(body @ other.field_enu)
        return np.asarray(np.hstack([body[:, :, 2], field]) / noise)

    def turned_in_body(axis: FloatArray, by: float) -> FloatArray:
        return measured(exp_rotations(by * axis[None]) @ attitude)

    def turned_in_world(axis: FloatArray, by: float) -> FloatArray:
        return measured(attitude @ exp_rotations(by * axis[None]))

    axes = minimal_rotation(UP_ENU, scene.axis / np.linalg.norm(scene.axis))
    upright = rotation_from_rpy(*scene.start_rpy) @ axes
    shared = [_slope(partial(measured, attitude, k)) for k in free]
    in_body = [_slope(partial(turned_in_body, axis)) for axis in axes.T]
    in_world = [_slope(partial(turned_in_world, axis)) for axis in upright.T[:2]]
    own, own_prior = [*in_body[:2], *in_world], [0.0] * 4
    local, local_prior = [], []
    if scene.wobble > 1e-5:
        local, local_prior = list(in_body[:2]), [scene.wobble**-2.0] * 2
    if gyro:
        swept = np.unwrap(_angle(attitude, axes, upright))
        own += [in_body[2], (swept - swept.mean())[:, None] * in_body[2]]
        own_prior += [0.0, GYRO_SCALE_SIGMA**-2.0]
    else:
        local, local_prior = [*local, in_body[2]], [*local_prior, 0.0]
    rest = np.stack([*shared, *own], axis=2)
    information = np.einsum("nij,nik->jk", rest, rest)
    if local:
        by = np.stack(local, axis=2)
        inner = np.einsum("nij,nik->njk", by, by) + np.diag(local_prior)
        cross = np.einsum("nij,nik->njk", by, rest)
        information -= np.einsum("nij,nik->jk", cross, np.linalg.solve(inner, cross))
    count = len(free)
    outer = information[count:, count:] + np.diag(own_prior)
    values, vectors = np.linalg.eigh(outer)
    seen = values > 1e-9 * values[-1]
    across = information[:count, count:] @ vectors[:, seen]
    return np.asarray(information[:count, :count] - (across / values[seen]) @ across.T)


def _angle(attitude: FloatArray, axes: FloatArray, upright: FloatArray) -> FloatArray:
    """Return the angle of the turn about its axis, radians, shape (n,)."""
    about = axes.T @ attitude @ upright
    return np.asarray(np.arctan2(about[:, 1, 0], about[:, 0, 0]))


def heading_rms(covariance: FloatArray, robot: Robot) -> tuple[float, float]:
    """Return the heading's standard deviation in degrees over the trial poses: level, all."""
    poses = trial_attitudes()
    jacobian = yaw_jacobian(robot.true_correction, poses @ UP_ENU, poses @ robot.field_enu)
    variance = np.einsum("...i,ij,...j->...", jacobian, covariance, jacobian)
    level, everywhere = variance[:, LEVEL_TILT].mean(), variance.mean()
    return math.degrees(math.sqrt(level)), math.degrees(math.sqrt(everywhere))
