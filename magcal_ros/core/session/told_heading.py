"""A heading that somebody tells, and what a node keeps of it while its robot goes on."""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.geometry.attitude import wrapped
from magcal_ros.core.geometry.vec3 import Triple, dot
from magcal_ros.core.heading.fusion_tuning import FusionTuning
from magcal_ros.core.samples.streams import STREAMS

DEGREES = 180.0 / math.pi
_FUSION = FusionTuning()


@dataclass(frozen=True)
class DockingTuning:
    """How a robot stands at a known heading.

    Parameters
    ----------
    seconds : float
        How long samples are averaged.
    fewest : int
        Samples of the field that are needed.
    patience : float
        Seconds, by another clock, after which those that came are too few.
    rate : float
        rad/s beyond the bias from which a robot turns.
    creep : float
        Tesla by which the field's mean may move meanwhile, noise apart.
    contradicted : float
        Sigmas by which a calibration in force may miss a known heading.
    same : float
        Radians within which another standing takes the place of one before: it says the same.
    most : int
        Standings that are kept.
    """

    seconds: float = 3.0
    fewest: int = 10
    patience: float = 15.0
    rate: float = math.radians(1.5)
    creep: float = 0.7e-6
    contradicted: float = 3.0
    same: float = math.radians(5.0)
    most: int = 24


TUNING = DockingTuning()


@dataclass(frozen=True)
class ToldHeading:
    """A heading that somebody tells.

    Parameters
    ----------
    yaw : float
        ENU yaw, radians: zero to the east, positive to the left.
    sigma : float
        Its standard deviation.
    is_true : bool
        Whether it is to true north; otherwise to magnetic north.
    """

    yaw: float
    sigma: float
    is_true: bool

    @property
    def in_words(self) -> str:
        """The heading for people."""
        north = "true" if self.is_true else "magnetic"
        return f"{wrapped(self.yaw) * DEGREES:.1f}° ±{self.sigma * DEGREES:.1f}° to {north} north"


class TurnSince:
    """The turn to the left since a standing, by the gyro."""

    def __init__(self) -> None:
        self.angle = 0.0
        self._variance, self._bias_sigma, self._seconds = 0.0, 0.0, 0.0
        self._stamp = math.nan

    def add(self, stamp: float, up: Triple, rate: Triple, bias_variance: float) -> None:
        """Go on to the next IMU message.

        Parameters
        ----------
        stamp : float
            Seconds.
        up : tuple of float
            Unit, body axes.
        rate : tuple of float
            Mean turn rate since the message before, rad/s, less the known bias.
        bias_variance : float
            Of that bias about up, (rad/s)².
        """
        seconds = stamp - self._stamp
        self._stamp = stamp
        if math.isnan(seconds):
            return
        if not 0.0 < seconds <= STREAMS.longest_gyro_step:
            self._variance = math.inf
            return
        tuning, turn = _FUSION, dot(rate, up)
        self.angle += turn * seconds
        self._variance += (tuning.angle_walk**2 + tuning.turn_error**2 * abs(turn)) * seconds
        self._seconds += seconds
        self._bias_sigma = max(self._bias_sigma, math.sqrt(bias_variance), tuning.bias_sigma)

    @property
    def sigma(self) -> float:
        """Standard deviation, radians; infinite where a gap is in it or nothing came."""
        if math.isnan(self._stamp):
            return math.inf
        return math.sqrt(self._variance) + self._bias_sigma * self._seconds
