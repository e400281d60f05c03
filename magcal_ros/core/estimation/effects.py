"""Errors with a known shape over the turn: so much of each, added to what is measured.

A linear acceleration, the current of motors, a field that comes late and an accelerometer beside
the turn's axis (doc/estimator.md, sections 4 and 9). The turn says how much there is of each.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from magcal_ros.core.estimation.pace import Pace
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY


class Effect(Enum):
    """What makes an error; its numbers stand together."""

    PULL = "pull"
    """Linear acceleration in body axes over gravity: its mean, and how it follows `swiftness`."""
    MOTORS = "motors"
    """Field scales in the magnetometer's axes: in proportion to the turn rate and to its square."""
    LATENCY = "latency"
    """Seconds by which the field comes later than the gyro."""
    LEVER_ARM = "lever_arm"
    """Metres from the turn's axis to the accelerometer, in body axes."""


@dataclass(frozen=True, eq=False)
class Effects:
    """What one unit of each number adds to up and field.

    Parameters
    ----------
    columns : ndarray, shape (n, 6, k)
        Three rows of up in body axes, three of the raw field in field scales.
    sigma : ndarray, shape (k,)
        Their priors, about zero.
    kinds : tuple of Effect
        What each number belongs to, k of them.
    """

    columns: FloatArray
    sigma: FloatArray
    kinds: tuple[Effect, ...]

    @classmethod
    def none(cls, count: int) -> Effects:
        """Return no effects on so many samples."""
        return cls(np.zeros((count, 6, 0)), np.zeros(0), ())

    def __len__(self) -> int:
        return len(self.kinds)

    def __contains__(self, kind: Effect) -> bool:
        return kind in self.kinds

    def where(self, kind: Effect) -> BoolArray:
        """Return which numbers are of a kind, shape (k,)."""
        return np.array([each is kind for each in self.kinds], dtype=bool)

    def only(self, kind: Effect) -> Effects:
        """Return those of one kind."""
        rows = self.where(kind)
        return Effects(self.columns[:, :, rows], self.sigma[rows], (kind,) * int(rows.sum()))

    def without_mean(self) -> Effects:
        """Return what of them varies in the course of the turn."""
        return Effects(self.columns - self.columns.mean(axis=0), self.sigma, self.kinds)

    def plus(self, other: Effects) -> Effects:
        """Return these and others after them."""
        columns = np.concatenate([self.columns, other.columns], axis=2)
        sigma = np.concatenate([self.sigma, other.sigma])
        return Effects(columns, sigma, self.kinds + other.kinds)


def pull(pace: Pace, sigma: float, follows: float) -> Effects:
    """Return the linear acceleration of a turn.

    Parameters
    ----------
    pace : Pace
    sigma : float
        Over gravity.
    follows : float
        By how much of its mean it is expected to grow with `swiftness`; the last three numbers are
        what it grows otherwise.
    """
    swift = pace.swiftness[:, None, None]
    columns = np.zeros((len(swift), 6, 6))
    columns[:, :3, :3] = (1.0 + follows * swift) * np.eye(3)
    columns[:, :3, 3:] = swift * np.eye(3)
    return Effects(columns, np.full(6, sigma), (Effect.PULL,) * 6)


@dataclass(frozen=True)
class EffectPriors:
    """How large an effect is that shows; one sigma.

    Parameters
    ----------
    motors : float
        Over the field's strength.
    latency : float
        Seconds.
    lever_arm : float
        Metres.
    """

    motors: float = 0.06
    latency: float = 0.05
    lever_arm: float = 0.3


def effects_of_rate(
    pace: Pace, field: FloatArray, distortion: FloatArray, priors: EffectPriors = EffectPriors()
) -> Effects:
    """Return what follows the turn rate.

    The motors' columns have no mean: whatever they add on the average of the turn is a hard iron.

    Parameters
    ----------
    pace : Pace
    field : ndarray, shape (n, 3)
        Raw field without the hard iron, field scales.
    distortion : ndarray, shape (3, 3)
        From the field in body axes to the raw field.
    priors : EffectPriors
    """
    count = len(field)
    columns = np.zeros((count, 6, 10))
    speed = pace.about / max(float(np.sqrt(np.mean(pace.about**2))), 1e-9)
    for place, shape in ((0, speed), (3, speed**2)):
        columns[:, 3:, place : place + 3] = (shape - shape.mean())[:, None, None] * np.eye(3)
    # A field that stands still in the world turns against the body; late, it has turned less.
    body = field @ np.linalg.inv(distortion).T
    columns[:, 3:, 6] = np.cross(pace.rate, body) @ distortion.T
    for k, arm in enumerate(np.eye(3)):
        inwards = np.cross(pace.axis, np.cross(pace.axis, arm))
        lean = np.outer(pace.about**2, inwards) + np.outer(pace.swing, np.cross(pace.axis, arm))
        columns[:, :3, 7 + k] = lean / STANDARD_GRAVITY
    sigma = np.repeat([priors.motors, priors.latency, priors.lever_arm], [6, 1, 3])
    kinds = (Effect.MOTORS,) * 6 + (Effect.LATENCY,) + (Effect.LEVER_ARM,) * 3
    return Effects(columns, sigma, kinds)
