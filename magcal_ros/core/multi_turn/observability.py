"""What an information matrix on the shared unknowns shows, and what one more turn would add."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.calibration.correction import PARAMETERS
from magcal_ros.core.calibration.heading_sigma import CHECKED_TILT, heading_jacobian, rms_sigma
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import field_in_enu
from magcal_ros.core.geometry.rotations import minimal_rotation, rotation_from_rpy
from magcal_ros.core.multi_turn.result import Advice, Shown
from magcal_ros.core.smoother.fit import Fit
from magcal_ros.core.smoother.posterior import Posterior, posterior_at
from magcal_ros.core.smoother.several import imagined_information
from magcal_ros.core.smoother.unknowns import (
    EARTH,
    MICROTESLA,
    SHARED,
    SHIELDING,
    SYMMETRIC,
    TURNED,
    YAW,
)

Z: FloatArray = np.array([0.0, 0.0, 1.0])

SLOPES = (("east", 0.0), ("north", 0.5 * math.pi), ("west", math.pi), ("south", 1.5 * math.pi))
LEANINGS = (
    ("the nose 10° up", (0.0, -CHECKED_TILT)),
    ("the nose 10° down", (0.0, CHECKED_TILT)),
    ("the left side 10° up", (CHECKED_TILT, 0.0)),
    ("the right side 10° up", (-CHECKED_TILT, 0.0)),
)


def heading_jacobians(found: Posterior) -> tuple[FloatArray, FloatArray]:
    """Return the derivative of the yaw by the twelve numbers: level (24, 12), tilted (96, 12)."""
    field = field_in_enu(found.strength, found.inclination)
    level, tilted = (
        heading_jacobian(found.correction, field, tilt) for tilt in (0.0, CHECKED_TILT)
    )
    return level, tilted


def relative(jacobian: FloatArray, level: FloatArray) -> FloatArray:
    """Return the Jacobian of the yaw after the level's common offset is taken off."""
    return np.asarray(jacobian - level.mean(axis=0))


def yaw_sigma(covariance: FloatArray) -> float:
    """Return the standard deviation of the installation's yaw, by a covariance (SHARED, SHARED)."""
    rows = [YAW, TURNED]
    return math.sqrt(float(covariance[np.ix_(rows, rows)].sum()))


def shown_by(information: FloatArray, fit: Fit, mounting: FloatArray) -> Shown:
    """Say what is shown.

    Parameters
    ----------
    information : ndarray, shape (SHARED, SHARED)
        On the unknowns that turns share, priors included; zero on others.
    fit : Fit
        Where.
    mounting : ndarray, shape (3, 3)
        From nominal body axes to sensor axes.
    """
    covariance = _inverse(information)
    found = posterior_at(fit.state, covariance, mounting)
    twelve = found.covariance
    level, tilted = heading_jacobians(found)
    axial = np.zeros(PARAMETERS)
    axial[9:] = np.linalg.solve(mounting, np.eye(3))[2]
    iron = np.zeros((6, SHARED))
    for part in SYMMETRIC:
        iron[:, part] = np.eye(6)
    iron[:2, SHIELDING] = 1.0
    north, down = fit.state.earth[1], -fit.state.earth[2]
    strength = math.hypot(north, down)
    along = np.array([north, down]) / strength
    earth = covariance[EARTH, EARTH]
    across = np.array([-along[1], along[0]]) / strength
    return Shown(
        installation_yaw=yaw_sigma(covariance),
        soft_iron=tuple(float(v) for v in np.sqrt(np.diag(iron @ covariance @ iron.T))),
        axial_hard_iron=math.sqrt(max(float(axial @ twelve @ axial), 0.0)),
        strength=math.sqrt(float(along @ earth @ along)) / MICROTESLA,
        inclination=math.sqrt(float(across @ earth @ across)),
        level=rms_sigma(relative(level, level), twelve),
        tilted=rms_sigma(relative(tilted, level), twelve),
        absolute_level=rms_sigma(level, twelve),
        absolute_tilted=rms_sigma(tilted, twelve),
    )


def _inverse(information: FloatArray) -> FloatArray:
    known = np.flatnonzero(np.diag(information) > 0.0)
    size = 1.0 / np.sqrt(np.diag(information)[known])
    scaled = information[np.ix_(known, known)] * np.outer(size, size)
    out = np.zeros_like(information)
    out[np.ix_(known, known)] = np.linalg.inv(scaled) * np.outer(size, size)
    return out


def advise(information: FloatArray, fit: Fit, mounting: FloatArray) -> tuple[Advice, ...]:
    """Return further turns, the one first that leaves the smallest absolute heading error.

    Each is imagined as one of the turns that were made, about another axis; what it is expected to
    say at the present estimate is added to what is there.

    Parameters
    ----------
    information : ndarray, shape (SHARED, SHARED)
        On the unknowns that turns share, priors included.
    fit : Fit
        Of the turn that is imagined once more.
    mounting : ndarray, shape (3, 3)
    """
    # What all attitudes keep is the axis of the turn, in the body and in the world.
    inside, _, outside = np.linalg.svd(fit.state.attitude.mean(axis=0))
    axis, up = (math.copysign(1.0, outside[0, 2]) * each for each in (inside[:, 0], outside[0]))

    def after(body: FloatArray, world: FloatArray) -> Shown:
        turned = minimal_rotation(axis, body), minimal_rotation(world, up)
        return shown_by(information + imagined_information(fit, *turned), fit, mounting)

    imagined = [Advice(pose, after(*each)) for pose, *each in _poses()]
    return tuple(sorted(imagined, key=lambda advice: advice.after.absolute_tilted))


def _poses() -> list[tuple[str, FloatArray, FloatArray]]:
    """Return what to do, and the turn's axis in the body and in the world."""
    poses = [("on the level once more", Z, Z)]
    for name, azimuth in SLOPES:
        lean = math.sin(CHECKED_TILT)
        normal = [-lean * math.cos(azimuth), -lean * math.sin(azimuth), math.cos(CHECKED_TILT)]
        poses.append((f"on a slope of 10° that rises to the {name}", Z, np.array(normal)))
    for name, (roll, pitch) in LEANINGS:
        poses.append((f"about the vertical with {name}", rotation_from_rpy(roll, pitch).T @ Z, Z))
    return poses
