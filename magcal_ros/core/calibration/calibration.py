"""A calibration: the correction, its covariance, and the evidence for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from magcal_ros.core.calibration.correction import PARAMETERS, Correction
from magcal_ros.core.calibration.estimate import Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.motors import MotorField
from magcal_ros.core.geometry.arrays import FloatArray, frozen_array


@dataclass(frozen=True)
class Evidence:
    """Why a calibration is believed, as it is stored beside the twelve numbers."""

    method: str
    """Name of the method that found it."""
    quality: str
    confidence: str
    """The verdict's two grades."""
    summary: str
    """The verdict in one sentence."""
    reasons: tuple[str, ...] = ()
    not_shown: tuple[str, ...] = ()
    """The verdict's reasons, and what the turn could not show."""
    accepted_by_user: bool = False
    """Whether a person put it in force against the verdict."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """What the method measured, SI units, by the names of `Figure`; a file of another version of
    the package may hold others."""

    def figure(self, name: Figure, default: float) -> float:
        """Return a figure, or `default` where it was not measured."""
        return self.figures.get(name.value, default)


@dataclass(frozen=True, eq=False)
class Calibration:
    """A correction with its certainty."""

    correction: Correction
    """The twelve numbers."""
    covariance: FloatArray
    """Of A row by row, then h in tesla. Shape (12, 12)."""
    noise_field: float
    """Tesla per axis, standard deviation of one raw field sample."""
    noise_up: float
    """Radians per axis, standard deviation of one accelerometer tilt."""
    strength: float
    inclination: float
    """The reference field as found, tesla and radians."""
    evidence: Evidence
    """Why it is believed."""
    motors: MotorField | None = None
    """What the motors add while they run; None where nothing has shown it."""

    def __post_init__(self) -> None:
        shape = (PARAMETERS, PARAMETERS)
        covariance = frozen_array(self.covariance, shape, "covariance")
        if (np.diag(covariance) < 0.0).any():
            raise ValueError("covariance has a negative variance")
        object.__setattr__(self, "covariance", covariance)

    @classmethod
    def from_estimate(cls, estimate: Estimate, evidence: Evidence) -> Calibration:
        """Bring a method's estimate, with why it is believed, into the form that is applied."""
        return cls(
            estimate.correction,
            estimate.covariance,
            estimate.noise_field,
            estimate.noise_up,
            estimate.strength,
            estimate.inclination,
            evidence,
            estimate.motors,
        )

    def on_users_word(self) -> Calibration:
        """Return the same calibration, marked as accepted by a person."""
        return replace(self, evidence=replace(self.evidence, accepted_by_user=True))
