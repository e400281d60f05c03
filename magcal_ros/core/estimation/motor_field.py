"""The field of the motors: what the robot itself switches on and off.

Where it sets off from a rest, or comes to one, the Earth's field, soft iron and the room are the
same before and after at one heading; what differs is the robot's own. Where something switches on
the way, the samples of one state are outliers of the other, all by the same field in its axes. And
what follows the turn rate was fitted with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.estimation.effects import Effect
from magcal_ros.core.estimation.free_attitude import FreeBlock
from magcal_ros.core.estimation.gyro_attitude import GyroBlock
from magcal_ros.core.estimation.gyro_path import GyroPath, RestOnPath
from magcal_ros.core.estimation.model import local_jacobian
from magcal_ros.core.estimation.solver import Fit
from magcal_ros.core.estimation.step_by_field import step_by_field
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, runs
from magcal_ros.core.samples.rest import RestBeside


@dataclass(frozen=True)
class MotorRule:
    """Which samples are held against a rest, and when their difference is more than chance.

    Parameters
    ----------
    angles : tuple of float
        Radians of turn between which samples are near a rest, and the robot surely moves.
    fewest : int
        Samples.
    scale : float
        Of the gyro, relative, 1 sigma, over this little turn.
    sigmas : float
        From which a step is more than chance.
    smallest : float
        Tesla below which none is worth a word.
    loud : float
        Times the field's noise from which an outlier shows what made it.
    least_run, fewest_runs : int
        Loud samples that make a stretch of outliers, and how many stretches make a switch: what
        passes by comes once.
    unlike : float
        Share of the outliers' squares that one field of the robot may leave unexplained.
    one_heading : float
        Mean resultant of the stretches' headings above which a thing in the room explains them.
    """

    angles: tuple[float, float] = (math.radians(3.0), math.radians(30.0))
    fewest: int = 5
    scale: float = 0.01
    sigmas: float = 5.0
    smallest: float = 0.2e-6
    loud: float = 2.5
    least_run: int = 3
    fewest_runs: int = 3
    unlike: float = 0.3
    one_heading: float = 0.9


MOTORS = MotorRule()


def motor_field(
    fit: Fit, path: GyroPath | None, scale: float, rests: tuple[RestBeside, ...] = ()
) -> FloatArray | None:
    """Return the field that is there in one state of the robot and not in another.

    Parameters
    ----------
    fit : Fit
        The optimum of one turn.
    path : GyroPath or None
        Of the same samples, where there is a gyro.
    scale : float
        Tesla of one field scale.
    rests : tuple of RestBeside
        Beside a turn without a gyro; a path has its own.

    Returns
    -------
    ndarray, shape (m, 3), or None
        Tesla, in the magnetometer's axes: what is seen, and one sigma of what cannot be seen of it.
        Zero where chance explains it, None where nothing tells.
    """
    step = _step_from_rest(fit, path, scale) if path else step_by_field(fit, rests, scale)
    found = [step, _switched(fit, scale), _by_rate(fit, scale)]
    seen = [np.atleast_2d(field) for field in found if field is not None]
    return max(seen, key=np.linalg.norm, default=None)


def _step_from_rest(fit: Fit, path: GyroPath, scale: float) -> FloatArray | None:
    steps = [_step(fit, path, rest, scale) for rest in path.rests]
    seen = [step for step in steps if step is not None]
    if not seen:
        return None
    weights = np.array([sigma**-2 for _, sigma in seen])
    mean = np.average([step for step, _ in seen], axis=0, weights=weights)
    size, sigma = float(np.linalg.norm(mean)), float(weights.sum()) ** -0.5
    return mean if size > max(MOTORS.sigmas * sigma, MOTORS.smallest) else np.zeros(3)


def _by_rate(fit: Fit, scale: float) -> FloatArray | None:
    """Return the most that currents which follow the turn rate were off the turn's mean."""
    block = fit.block
    if not isinstance(block, GyroBlock) or Effect.MOTORS not in block.path.effects:
        return None
    columns = block.path.effects.only(Effect.MOTORS).columns[:, 3:]
    added = columns @ block.path.found(block.errors, Effect.MOTORS)
    return np.asarray(scale * added[np.argmax(np.linalg.norm(added, axis=1))])


def _switched(fit: Fit, scale: float) -> FloatArray | None:
    """Return the one field of the robot by which stretches of outliers differ from the rest."""
    block = fit.block
    place, noise = block.place, block.weighting.noise.field
    residual = place.prediction.field_residual
    loud = ~block.weighting.inliers & (np.linalg.norm(residual, axis=1) > MOTORS.loud * noise)
    stretches = [np.arange(a, b)[loud[a:b]] for a, b in runs(~block.weighting.inliers)]
    stretches = [rows for rows in stretches if len(rows) >= MOTORS.least_run]
    if len(stretches) < MOTORS.fewest_runs:
        return None
    attitude = place.state.attitude
    heading = np.arctan2(attitude[:, 1, 0], attitude[:, 0, 0])
    around = np.mean([np.exp(1j * heading[rows]).mean() for rows in stretches])
    rows = np.concatenate(stretches)
    seen = np.broadcast_to(np.eye(3), (len(rows), 3, 3))
    if isinstance(block, FreeBlock):
        # An attitude of its own has followed whatever part looked like a turn.
        turns = local_jacobian(place.prediction)[rows, 3:, 2]
        along = turns / np.linalg.norm(turns, axis=1, keepdims=True)
        seen = seen - along[:, :, None] * along[:, None, :]
    field = np.linalg.solve(seen.sum(axis=0), np.sum(residual[rows], axis=0))
    left = np.sum((residual[rows] - seen @ field) ** 2) - 3.0 * len(rows) * noise**2
    alike = left < MOTORS.unlike * np.sum(residual[rows] ** 2) and abs(around) < MOTORS.one_heading
    return -scale * field if alike and scale * np.linalg.norm(field) > MOTORS.smallest else None


def _step(
    fit: Fit, path: GyroPath, rest: RestOnPath, scale: float
) -> tuple[FloatArray, float] | None:
    """Return how much more field there is in motion than at one rest, and its sigma; tesla."""
    cosine = 0.5 * (np.sum(path.relative * rest.relative, axis=(1, 2)) - 1.0)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    near = _near(angle, from_start=rest.is_before)
    if near.sum() < MOTORS.fewest:
        return None
    block = fit.block
    believed = near & block.weighting.inliers
    near = believed if believed.sum() >= MOTORS.fewest else near
    shared = block.place.state.shared
    body = shared.body_axis @ block.place.state.attitude[near] @ shared.world_axis.T
    left, _, right = np.linalg.svd((np.swapaxes(path.relative[near], 1, 2) @ body).sum(axis=0))
    earth = left @ right @ shared.field_enu
    turned = (path.relative[near] - rest.relative) @ earth @ shared.distortion(fit.mounting).T
    steps = block.place.samples.field[near] - rest.seen.field / scale - turned
    count = max(float(near.sum()) / block.weighting.inefficiency, 1.0)
    variance = block.weighting.noise.field**2 / count + (rest.seen.field_sigma / scale) ** 2
    stretch = MOTORS.scale * float(angle[near].mean()) * abs(shared.strength)
    return scale * steps.mean(axis=0), scale * math.hypot(math.sqrt(variance), stretch)


def _near(angle: FloatArray, *, from_start: bool) -> BoolArray:
    """Return which samples (n,) are near a rest, before the turn leads away from it."""
    least, most = MOTORS.angles
    inside = angle < most
    away = np.cumsum(~inside if from_start else ~inside[::-1])
    return np.asarray(((away if from_start else away[::-1]) == 0) & (angle > least))
