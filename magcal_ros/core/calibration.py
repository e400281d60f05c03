"""A calibration in force: the correction, how sure it is, and what speaks for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from magcal_ros.core.arrays import FloatArray, frozen_array
from magcal_ros.core.correction import PARAMETERS, Correction
from magcal_ros.core.estimate import Estimate
from magcal_ros.core.verdict import Verdict


@dataclass(frozen=True)
class Evidence:
    """Why a calibration is believed, as it is stored beside the twelve numbers.

    Parameters
    ----------
    method : str
        Name of the method that found it.
    quality, confidence : str
        The verdict's two grades.
    summary : str
        The verdict in one sentence.
    reasons, not_shown : tuple of str
        The verdict's reasons, and what the turn could not show.
    accepted_by_user : bool
        Whether a person put it in force against the verdict.
    figures : mapping of str to float
        What the method measured, SI units.
    """

    method: str
    quality: str
    confidence: str
    summary: str
    reasons: tuple[str, ...] = ()
    not_shown: tuple[str, ...] = ()
    accepted_by_user: bool = False
    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Calibration:
    """A correction with its certainty.

    Parameters
    ----------
    correction : Correction
        The twelve numbers.
    covariance : array_like, shape (12, 12)
        Of A row by row, then h in tesla.
    noise_field : float
        Tesla per axis, standard deviation of one raw field sample.
    noise_up : float
        Radians per axis, standard deviation of one accelerometer tilt.
    strength, inclination : float
        The reference field as found, tesla and radians.
    evidence : Evidence
        Why it is believed.
    """

    correction: Correction
    covariance: FloatArray
    noise_field: float
    noise_up: float
    strength: float
    inclination: float
    evidence: Evidence

    def __post_init__(self) -> None:
        shape = (PARAMETERS, PARAMETERS)
        covariance = frozen_array(self.covariance, shape, "covariance")
        if (np.diag(covariance) < 0.0).any():
            raise ValueError("covariance has a negative variance")
        object.__setattr__(self, "covariance", covariance)

    @classmethod
    def from_estimate(cls, estimate: Estimate, verdict: Verdict) -> Calibration:
        """Bring a method's estimate and its verdict into the form that is applied and stored."""
        evidence = Evidence(
            estimate.method,
            verdict.quality.value,
            verdict.confidence.value,
            verdict.summary,
            tuple(check.words for check in verdict.checks),
            verdict.not_shown,
            figures=dict(estimate.figures),
        )
        return cls(
            estimate.correction,
            estimate.covariance,
            estimate.noise_field,
            estimate.noise_up,
            estimate.strength,
            estimate.inclination,
            evidence,
        )

    def on_users_word(self) -> Calibration:
        """Return the same calibration, marked as accepted by a person."""
        return replace(self, evidence=replace(self.evidence, accepted_by_user=True))
