"""The Cramér-Rao limit: no unbiased estimator can do better on these samples.

Fisher information at the truth, under the same model and beliefs as the maximum-likelihood fit,
carried to the covariance of the twelve numbers and from there to the heading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.estimate import yaw_jacobian
from magcal_ros.core.estimation.free_attitude import FreeBlock
from magcal_ros.core.estimation.free_equations import SchurSystem
from magcal_ros.core.estimation.information import inverse_information, without_own
from magcal_ros.core.estimation.model import Evaluation, Samples, State, predict
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.estimation.prior import Prior, prior_from
from magcal_ros.core.estimation.uncertainty import correction_jacobian
from magcal_ros.core.estimation.weighting import Noise, Weighting, Weights
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.core.geometry.rotations import minimal_rotation, rotation_from_rpy
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.simulation.simulator import LEVEL_TILT, UP_ENU, Motion, Robot, trial_attitudes

GYRO_SCALE_SIGMA = 0.02
SOFT_IRON_ROWS = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
"""Where E holds the fit's six soft-iron numbers."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One turn of one robot: everything the limit depends on."""

    robot: Robot
    motion: Motion
    axis: FloatArray
    start_rpy: tuple[float, float, float]
    wobble: float


def covariance_limit(
    scene: Scene, knowledge: Knowledge, *, soft_iron: bool = False, gyro: bool = False
) -> FloatArray:
    """Return the smallest covariance of the twelve numbers, shape (12, 12)."""
    robot = scene.robot
    prior = prior_from(knowledge, robot.strength, soft_iron=soft_iron)
    state = true_state(scene)
    mounting = robot.mounting.matrix
    blank = Samples(
        np.zeros((len(state.attitude), 3)), np.zeros((len(state.attitude), 3)), mounting
    )
    said = predict(state, blank)
    samples = Samples(-said.up_residual @ state.shared.body_axis.T, -said.field_residual, mounting)
    noise = Noise(
        robot.noise_force / STANDARD_GRAVITY,
        robot.noise_field / robot.strength,
        max(scene.wobble, 1e-5),
    )
    weighting = Weighting(noise, Weights.ones(len(samples)))
    block = FreeBlock(Evaluation(state, samples), weighting, leans=scene.wobble > 0.0)
    system = block.equations(np.concatenate([block.own, prior.free])).system
    information = _with_gyro(system, scene) if gyro else system.reduced(0.0).information
    information = without_own(information, len(block.own))
    information += np.diag(prior.information[prior.free])
    return _twelve(information, state, prior, scene)


def true_state(scene: Scene) -> State:
    """Return the truth in the fit's own parameters."""
    robot = scene.robot
    body_axis = minimal_rotation(UP_ENU, scene.axis / np.linalg.norm(scene.axis))
    world_axis = rotation_from_rpy(*scene.start_rpy) @ body_axis
    shared = Globals(
        body_axis,
        world_axis,
        robot.roll,
        robot.pitch,
        robot.hard_iron / robot.strength,
        1.0,
        robot.inclination,
        robot.soft_iron[SOFT_IRON_ROWS],
    )
    return State(shared, body_axis.T @ scene.motion.attitude @ world_axis)


def _with_gyro(system: SchurSystem, scene: Scene) -> FloatArray:
    """Eliminate a start angle and a scale error instead of one attitude a sample."""
    n = len(scene.motion.time)
    attitude = system.place.state.attitude
    angle = np.unwrap(np.arctan2(attitude[:, 1, 0], attitude[:, 0, 0]))
    basis = np.column_stack([np.ones(n), angle - angle.mean()])
    column = -1
    information = system.local.information[:, column, column]
    coupling = system.coupling[:, column]
    small = basis.T @ (basis * information[:, None]) + np.diag([0.0, GYRO_SCALE_SIGMA**-2])
    cross = basis.T @ coupling
    return np.asarray(system.information - cross.T @ np.linalg.solve(small, cross))


def _twelve(information: FloatArray, state: State, prior: Prior, scene: Scene) -> FloatArray:
    robot = scene.robot
    jacobian = correction_jacobian(state.shared, robot.mounting.matrix, robot.strength)
    jacobian = jacobian[:, prior.free]
    return np.asarray(jacobian @ inverse_information(information) @ jacobian.T)


def heading_rms(covariance: FloatArray, robot: Robot) -> tuple[float, float]:
    """Return the heading's standard deviation in degrees over the trial poses: level, all."""
    poses = trial_attitudes()
    jacobian = yaw_jacobian(robot.true_correction, poses @ UP_ENU, poses @ robot.field_enu)
    variance = np.einsum("...i,ij,...j->...", jacobian, covariance, jacobian)
    level, everywhere = variance[:, LEVEL_TILT].mean(), variance.mean()
    return math.degrees(math.sqrt(level)), math.degrees(math.sqrt(everywhere))
