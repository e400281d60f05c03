"""The result of a method (`Estimate`), and the stored and applied `Calibration`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from magcal_ros.core.calibration.correction import PARAMETERS, Correction, MotorField
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, freeze
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.rotations import (
    in_axes,
    rotation_angle,
    rotation_from_rpy,
    rpy_from_rotation,
)
from magcal_ros.core.knowledge import ReferenceField, Z


@dataclass(frozen=True)
class Installation:
    """The rotation of the magnetometer from its nominal pose in the IMU's frame.

    Radians as in a URDF origin. After one turn the yaw is zero by convention, because it is
    observable only with turns at different tilts.
    """

    roll: float
    pitch: float
    yaw: float = 0.0

    @property
    def pose(self) -> FloatArray:
        """Sensor axes to body axes, shape (3, 3)."""
        return rotation_from_rpy(self.roll, self.pitch, self.yaw)

    def in_axes(self, rotation: FloatArray) -> Installation:
        """Return the same installation for rotated axes of the IMU's frame."""
        return Installation(*rpy_from_rotation(rotation @ self.pose @ rotation.T))

    @property
    def angle(self) -> float:
        """Angle of the whole rotation from the nominal pose, radians."""
        return rotation_angle(self.pose)


@dataclass(frozen=True, eq=False)
class GyroSwing:
    """The persistent deviation of the compass from the gyro over a turn."""

    heading: FloatArray
    """ENU yaw to magnetic north of the turn's sectors or of samples, radians. Shape (s,)."""
    deviation: FloatArray
    """Compass minus gyro there, without errors of the gyro, radians. Shape (s,)."""
    rms: float  # RMS of the deviation without the noise of the means, radians


class FittedGyroBias(NamedTuple):
    """A gyro's error at the mean rate of a window, as one bias, by the fit of a calibration."""

    rate: FloatArray  # rad/s, body axes. Shape (3,).
    covariance: FloatArray  # (rad/s)². Shape (3, 3).

    def in_axes(self, rotation: FloatArray) -> FittedGyroBias:
        """Return the same bias in rotated body axes."""
        return FittedGyroBias(rotation @ self.rate, rotation @ self.covariance @ rotation.T)


@dataclass(frozen=True, eq=False)
class Estimate:
    """The result of one method on one window."""

    method: str
    correction: Correction
    covariance: FloatArray
    """Of the twelve numbers (A row by row, then h in tesla), including unobservable directions. It
    is singular if a direction is fixed by convention. Shape (12, 12)."""
    installation: Installation | None  # installation error, if the method estimates it
    axis: FloatArray  # the turn's axis in body axes, unit, upwards. Shape (3,).
    arc: float  # radians of the turn that were seen
    strength: float
    inclination: float
    """Of the reference field after the fit: tesla, radians."""
    noise_field: float
    noise_up: float
    """Standard deviations found in the samples: tesla per axis, radians of tilt per axis."""
    inliers: BoolArray  # samples that are not outliers. Shape (n,).
    residual: FloatArray  # raw field minus the model, tesla. Shape (n, 3).
    figures: Mapping[Figure, float] = field(default_factory=dict)
    """Other figures of the method; SI units."""
    message: str = ""
    swing: GyroSwing | None = None
    """The data of `Figure.GYRO_COMPASS_SWING`, if gyro and compass were compared."""
    motors: MotorField | None = None  # the field of the running motors, if the method finds it
    gyro: FittedGyroBias | None = None
    """The gyro's error; None without a whole gyro, or if a bias from a rest was subtracted."""
    upward: FloatArray = field(default_factory=lambda: Z)  # `Mounting.upward`

    def __post_init__(self) -> None:
        freeze(self, covariance=(PARAMETERS, PARAMETERS), axis=(3,), upward=(3,))

    def in_axes(self, rotation: FloatArray) -> Estimate:
        """Return the same estimate in rotated body axes."""
        return replace(
            self,
            **_numbers_in_axes(self, rotation),
            installation=in_axes(self.installation, rotation),
            axis=rotation @ self.axis,
            gyro=in_axes(self.gyro, rotation),
        )

    @property
    def circle_radius(self) -> float:
        """Horizontal part of the reference field after the fit, tesla."""
        return self.strength * math.cos(self.inclination)


def yaw_jacobian(correction: Correction, up: FloatArray, field_body: FloatArray) -> FloatArray:
    """Return the derivative of the yaw by the twelve numbers, shape (..., 12), radians each.

    The yaw changes with the field's component towards east: d(yaw) = (east . dm) / |m x u|, with
    east = (m x u)/|m x u| and a change dm of the field in body axes.
    """
    across = np.cross(field_body, unit(up))
    gradient = across / np.sum(across**2, axis=-1, keepdims=True)
    return gradient_by_parameters(correction, field_body, gradient)


def gradient_by_parameters(
    correction: Correction, field_body: FloatArray, gradient: FloatArray
) -> FloatArray:
    """Return the derivative by the twelve numbers of a quantity with this gradient by the field.

    The corrected field and the gradient are (..., 3) in body axes.
    """
    uncorrected = correction.undo(field_body) - correction.hard_iron
    by_matrix = gradient[..., :, None] * uncorrected[..., None, :]
    by_iron = -gradient @ correction.matrix
    flat = by_matrix.reshape(*by_matrix.shape[:-2], 9)
    return np.concatenate([flat, by_iron], axis=-1)


@dataclass(frozen=True)
class Evidence:
    """The evidence for a calibration, stored with the twelve numbers."""

    method: str
    quality: str
    confidence: str
    """The verdict's two grades."""
    summary: str
    reasons: tuple[str, ...] = ()
    not_shown: tuple[str, ...] = ()
    """The verdict's reasons, and the quantities that the turn did not determine."""
    accepted_by_user: bool = False  # whether the user put it in force against the verdict
    figures: Mapping[str, float] = field(default_factory=dict)
    """Figures of the method, SI, by the names of `Figure`; other versions may have others."""

    def made_with(self, reference: ReferenceField) -> Evidence:
        """Return the same evidence with the reference field that was used, if it is known."""
        if not reference.is_complete:
            return self
        used = {
            Figure.REFERENCE_STRENGTH.value: reference.strength.value,
            Figure.REFERENCE_INCLINATION.value: reference.inclination.value,
        }
        return replace(self, figures={**self.figures, **used})

    def figure(self, name: Figure, default: float) -> float:
        """Return a figure, or `default` if it was not measured."""
        return self.figures.get(name.value, default)


@dataclass(frozen=True, eq=False)
class Calibration:
    """A correction with its covariance and evidence."""

    correction: Correction
    covariance: FloatArray
    """Of A row by row, then h in tesla. Shape (12, 12)."""
    noise_field: float  # tesla per axis, standard deviation of one raw field sample
    noise_up: float  # radians per axis, standard deviation of one accelerometer tilt
    strength: float
    inclination: float
    """The estimated reference field, tesla and radians."""
    evidence: Evidence
    motors: MotorField | None = None
    """The field of the running motors; None if it was not observed."""
    upward: FloatArray = field(default_factory=lambda: Z)  # `Mounting.upward`

    def __post_init__(self) -> None:
        freeze(self, covariance=(PARAMETERS, PARAMETERS), upward=(3,))
        if (np.diag(self.covariance) < 0.0).any():
            raise ValueError("covariance has a negative variance")
        if not abs(float(np.linalg.norm(self.upward)) - 1.0) < 1e-3:
            raise ValueError("the top of a vehicle is a unit vector")

    @classmethod
    def from_estimate(cls, estimate: Estimate, evidence: Evidence) -> Calibration:
        """Return the calibration of a method's estimate, with its evidence."""
        return cls(
            estimate.correction,
            estimate.covariance,
            estimate.noise_field,
            estimate.noise_up,
            estimate.strength,
            estimate.inclination,
            evidence,
            estimate.motors,
            estimate.upward,
        )

    def in_axes(self, rotation: FloatArray) -> Calibration:
        """Return the same calibration in rotated body axes."""
        return replace(self, **_numbers_in_axes(self, rotation))

    def accepted_by_person(self) -> Calibration:
        """Return the same calibration, marked as accepted by the user."""
        return replace(self, evidence=replace(self.evidence, accepted_by_user=True))


def _numbers_in_axes(found: Estimate | Calibration, rotation: FloatArray) -> dict[str, Any]:
    """Return the fields of an estimate or a calibration that have other values in rotated axes."""
    change = np.eye(PARAMETERS)
    change[:9, :9] = np.kron(rotation, np.eye(3))
    return {
        "correction": found.correction.in_axes(rotation),
        "covariance": change @ found.covariance @ change.T,
        "motors": None if found.motors is None else found.motors.with_numbers_changed(change),
        "upward": rotation @ found.upward,
    }
