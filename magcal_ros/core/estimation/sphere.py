"""First guesses of the shared numbers from all turns together."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.estimation.model import Samples
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import rotation_from_rpy, rpy_from_rotation


@dataclass(frozen=True)
class SphereTuning:
    """What circles on different tilts must show.

    Parameters
    ----------
    thinnest : float
        Share of the sphere that they must leave out of one plane.
    least_round : float
        Length of cosine and sine of the yaw, found apart, below which they show none; nor do they
        beyond its inverse.
    least_turned : float
        How much of the level field must lean against up for gravity to show the yaw.
    """

    thinnest: float = 0.05
    least_round: float = 0.5
    least_turned: float = 0.02


SPHERE = SphereTuning()


def sphere_guess(turns: list[Samples], guess: Globals) -> Globals:
    """Return hard iron and strength by the sphere that all turns lie on, and what follows.

    The sphere |K^-1 m - K^-1 h| = B is linear in the centre and in B² - |centre|². Where the
    circles lie in one plane, those of the guess stay.

    Parameters
    ----------
    turns : list of Samples
        Inliers of each turn.
    guess : Globals
        Of one turn alone.
    """
    mounting = turns[0].mounting
    inverse = np.linalg.inv(mounting)
    points = np.vstack([turn.field for turn in turns]) @ inverse.T
    up = np.vstack([turn.up for turn in turns])
    centre, strength = inverse @ guess.hard_iron, guess.strength
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[2] > SPHERE.thinnest * spread[0]:
        columns = np.column_stack([2.0 * points, np.ones(len(points))])
        answer = np.linalg.lstsq(columns, np.sum(points**2, axis=1), rcond=None)[0]
        centre = answer[:3]
        strength = math.sqrt(max(float(answer[3] + centre @ centre), 1e-6))
    found = replace(
        guess, hard_iron=mounting @ centre, strength=strength, soft_iron=np.zeros(6), yaw=0.0
    )
    field = points - centre
    return turned_to_gravity(replace(found, yaw=_yaw_by_gravity(found, up, field)), up, field)


def _yaw_by_gravity(guess: Globals, up: FloatArray, field: FloatArray) -> float:
    """Return the yaw under which gravity and field keep their angle; zero where none is shown.

    The angle's cosine is linear in cosine and sine of the yaw. Noise alone draws both to zero.
    """
    x, y, z = (field @ guess.installation / guess.strength).T
    columns = np.column_stack(
        [up[:, 0] * x + up[:, 1] * y, up[:, 1] * x - up[:, 0] * y, np.ones(len(up))]
    )
    cosine, sine, _ = np.linalg.lstsq(columns, -up[:, 2] * z, rcond=None)[0]
    shown = SPHERE.least_round < math.hypot(cosine, sine) < 1.0 / SPHERE.least_round
    return math.atan2(sine, cosine) if shown else 0.0


def turned_to_gravity(guess: Globals, up: FloatArray, field: FloatArray) -> Globals:
    """Return the guess with installation and dip such that gravity and field keep their angle.

    `up . R^T field` is linear in the nine elements of R; near the guess, in three small turns and
    in the sine of the dip.

    Parameters
    ----------
    guess : Globals
    up, field : ndarray, shape (n, 3)
        Up in body axes; field in installed axes, hard iron taken off.
    """
    pose = guess.installation.T
    sine = 0.0
    for _ in range(4):
        body = field @ pose.T / guess.strength
        columns = np.column_stack([np.cross(body, up), np.ones(len(up))])
        measured = -np.sum(up * body, axis=1)
        prior = np.sqrt(SPHERE.least_turned**2 * len(up)) * np.eye(4)[:3]
        answer = np.linalg.lstsq(
            np.vstack([columns, prior]), np.concatenate([measured, np.zeros(3)]), rcond=None
        )[0]
        sine = float(answer[3])
        size = float(np.linalg.norm(answer[:3]))
        turn = answer[:3] * min(1.0, 0.5 / max(size, 1e-12))
        angles = turn.tolist()
        pose = rotation_from_rpy(angles[0], angles[1], angles[2]) @ pose
    roll, pitch, yaw = rpy_from_rotation(pose)
    dip = math.asin(min(max(sine, -0.99), 0.99))
    return replace(guess, roll=roll, pitch=pitch, yaw=yaw, inclination=dip)
