"""Errors that do not average out, as a covariance of the twelve numbers (doc/estimator.md, 10).

A heading error that goes once round with the robot, whatever made it, is what a hard iron across
the turn's axis would make: `(field level) times (radians)`. So centripetal lean, latency, the
lasting deviation of gyro against compass and the gap between fits with and without the gyro all
enter as hard iron in the plane of the turn. The magnetometer's axes enter as a turn about the axis
of the robot's, which one turn cannot show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit
from magcal_ros.core.geometry.rotations import skew, turns_about_z
from magcal_ros.core.knowledge import Systematics

TWO_SEEN = math.sqrt(0.5)
"""Two numbers that come out large are so by chance as well: what they say of a third, over them."""


@dataclass(frozen=True)
class Turning:
    """How fast a robot turned, rad/s.

    Parameters
    ----------
    rms : float
        Root mean square of the rate.
    spread : float
        Its standard deviation: a latency shifts an even turn as a whole, and that shows nothing.
    """

    rms: float
    spread: float

    @classmethod
    def by_gyro(cls, rate: FloatArray) -> Turning:
        """Return it from turn rates, shape (n, 3)."""
        mean = rate.mean(axis=0)
        about = rate @ unit(mean) if mean.any() else rate[:, 2]
        return cls(math.sqrt(float(np.mean(np.sum(rate**2, axis=1)))), float(about.std()))

    @classmethod
    def by_attitude(cls, time: FloatArray, attitude: FloatArray) -> Turning:
        """Return it from attitudes (n, 3, 3) at stamps (n,), by the second; none from one."""
        span = float(np.ptp(time)) if len(time) else 0.0
        if span == 0.0:
            return cls(0.0, 0.0)
        moments = np.linspace(time[0], time[-1], max(round(span), 1) + 1)
        yaw = np.interp(moments, time, np.unwrap(turns_about_z(attitude)))
        rate = np.diff(yaw) / np.diff(moments)
        return cls(math.sqrt(float(np.mean(rate**2))), float(np.abs(rate).std()))


@dataclass(frozen=True, eq=False)
class Lasting:
    """What samples and rests show of errors that last.

    Parameters
    ----------
    deviation : float
        Lasting swing of the compass's yaw, radians of heading, RMS around the turn: its share of
        that against the gyro's, or what goes with a deviation along the radius.
    gap : float
        Heading that other explanations of the gyro leave in doubt, radians, one sigma; zero where
        there is but one.
    motors : ndarray, shape (m, 3), or None
        Field that is there while the robot turns and not while it rests, tesla, in the
        magnetometer's axes: a hard iron that is there or not. First what is seen of it, then one
        sigma along each direction in which none of it can be seen.
    pull : float
        How far up may be pulled to one side without a trace, radians per axis, one sigma.
    """

    deviation: float = 0.0
    gap: float = 0.0
    motors: FloatArray | None = None
    pull: float = 0.0


def systematic_covariance(
    shared: Globals,
    mounting: FloatArray,
    scale: float,
    systematics: Systematics,
    turning: Turning,
    seen: Lasting,
) -> FloatArray:
    """Return what lasting errors add to the covariance of the twelve numbers, shape (12, 12).

    Parameters
    ----------
    shared : Globals
        The optimum.
    mounting : ndarray, shape (3, 3)
    scale : float
        Tesla of one field scale.
    systematics : Systematics
    turning : Turning
    seen : Lasting
    """
    distortion = shared.distortion(mounting)
    axis = shared.body_axis[:, 2]
    strength = scale * abs(shared.strength)
    level = strength * math.cos(shared.inclination)
    upright = strength * abs(math.sin(shared.inclination))
    lean = systematics.lever_arm * turning.rms**2 / STANDARD_GRAVITY
    late = systematics.latency * turning.spread
    # A lean to one side is half a hard iron across along each axis.
    leans = 0.5 * lean**2 + seen.pull**2
    lasting = upright**2 * leans + level**2 * (late**2 + seen.deviation**2 + seen.gap**2)
    across = np.eye(3) - np.outer(axis, axis)
    covariance = np.zeros((12, 12))
    of_iron = systematics.field**2 * np.eye(3) + lasting * across
    covariance[9:, 9:] = distortion @ of_iron @ distortion.T
    if seen.motors is not None:
        covariance[9:, 9:] += seen.motors.T @ seen.motors
    turned = (-skew(axis) @ np.linalg.inv(distortion)).ravel()
    unseen = math.hypot(systematics.axes, _unseen_turn(shared.soft_iron, systematics))
    covariance[:9, :9] = unseen**2 * np.outer(turned, turned)
    return covariance


def _unseen_turn(soft_iron: FloatArray, systematics: Systematics) -> float:
    """Return the turn about the axis that axes have which are as crooked as a level turn shows.

    Of errors that are alike in all nine numbers of the axes, a level turn shows two, the ellipse,
    and hides a third of the same size, the turn. Of soft iron it hides nothing of the kind.
    """
    if systematics.axes == 0.0:
        return 0.0
    xx, yy, _, xy, _, _ = soft_iron
    seen = math.hypot(0.5 * (xx - yy), xy) / math.sqrt(2.0)
    return float(TWO_SEEN * seen / (1.0 + (seen / systematics.crooked) ** 4))
