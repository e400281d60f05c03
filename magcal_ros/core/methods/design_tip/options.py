"""What the user of the design tip may choose."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from magcal_ros.core.geometry.conics import ConicFit
from magcal_ros.core.geometry.planes import PlaneFit


class AxisSource(str, Enum):
    """Where the turn's axis comes from."""

    AUTO = "auto"
    MEAN = "mean"
    PLANE = "plane"


@dataclass(frozen=True)
class Options:
    """Choices of the design tip.

    Raises
    ------
    ValueError
        For a name that is none of the choices.
    """

    plane: PlaneFit = PlaneFit.EIGEN
    """Fit of the planes of gravity and field."""
    conic: ConicFit = ConicFit.TAUBIN
    """Fit of the field's circle."""
    axis: AxisSource = AxisSource.AUTO
    """Centre of the accelerometer's circle, normal of its plane, or both by their variances."""
    min_samples: int = 20
    """Fewer are refused."""
    jackknife_blocks: int = 16
    """Pieces of time that the covariance leaves out one by one."""
    axial_sigma: float = 50e-6
    """Tesla, standard deviation of the hard iron along the axis when neither strength nor
    inclination is known."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "plane", PlaneFit(self.plane))
        object.__setattr__(self, "conic", ConicFit(self.conic))
        object.__setattr__(self, "axis", AxisSource(self.axis))
