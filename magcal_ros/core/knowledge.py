"""Prior knowledge: the reference field, the mounting of the sensor, soft iron."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import wraps
from typing import ParamSpec, TypeVar

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, freeze
from magcal_ros.core.geometry.attitude import angle_between, unit
from magcal_ros.core.geometry.rotations import in_axes, minimal_rotation

P = ParamSpec("P")
T = TypeVar("T")

STRENGTH_SIGMA_UT = 1.5
INCLINATION_SIGMA_DEG = 1.0
DECLINATION_SIGMA_DEG = 0.5
"""Local deviation of the field outdoors (1 σ); indoors it is about 7 µT, 5° and 5°."""

STREET_LENGTH = 30.0
"""Correlation length of the local disturbance along a path, metres; 25 to 30 m in cities."""

CLEAR = 3.0  # sigmas from which a deviation is significant, and two sources contradict each other

Z: FloatArray = np.array([0.0, 0.0, 1.0])

UNKNOWN_YAW = math.pi**2 / 3.0  # variance of an unknown yaw, rad²


def level_rotation(upward: FloatArray) -> FloatArray:
    """Return the smallest rotation of axes, (3, 3), that turns the vehicle's top (3,) to z."""
    return minimal_rotation(unit(upward), Z)


def in_level_axes(compute: Callable[P, T]) -> Callable[P, T]:
    """Return a function that calls `compute` in level axes; its result is in the IMU's axes again.

    What is known of sensors and motion refers to the vertical, but an IMU may be mounted on its
    side. One of the arguments has `upward` (3,), the top of the vehicle in the IMU's axes.
    """

    @wraps(compute)
    def computed(*inputs: P.args, **options: P.kwargs) -> T:
        every = (*inputs, *options.values())
        turn = level_rotation(next(each.upward for each in every if hasattr(each, "upward")))
        return in_axes(compute(*in_axes(inputs, turn), **in_axes(options, turn)), turn.T)

    return computed


@dataclass(frozen=True)
class Belief:
    """One number that is known, uncertain or unknown."""

    value: float  # the expectation; ignored if the number is unknown
    sigma: float = 0.0  # standard deviation in the same unit: zero for known, infinite for unknown

    def __post_init__(self) -> None:
        if not math.isfinite(self.value) or math.isnan(self.sigma) or self.sigma < 0.0:
            raise ValueError("a belief needs a finite value and a sigma of zero or more")

    @classmethod
    def unknown(cls) -> Belief:
        """Return a belief of infinite sigma."""
        return cls(0.0, math.inf)

    @property
    def is_unknown(self) -> bool:
        """Whether the sigma is infinite."""
        return math.isinf(self.sigma)

    @property
    def is_exact(self) -> bool:
        """Whether the sigma is zero."""
        return self.sigma == 0.0


@dataclass(frozen=True)
class ReferenceField:
    """The Earth's field where the robot turns.

    Raises `ValueError` for a strength that is not positive, and for angles that are no radians.
    """

    strength: Belief = field(default_factory=Belief.unknown)  # tesla
    inclination: Belief = field(default_factory=Belief.unknown)
    """Radians, positive where the field points down."""
    declination: float | None = None
    """Radians, positive where magnetic north lies east of true north; None if not known."""
    declination_sigma: float = 0.0
    """Standard deviation of the declination, radians; it is part of a yaw to true north."""

    def __post_init__(self) -> None:
        if not isinstance(self.strength, Belief) or not isinstance(self.inclination, Belief):
            raise ValueError("strength and inclination of a reference are beliefs: Belief(48e-6)")
        strength, inclination = self.strength, self.inclination
        if not strength.is_unknown and not 0.0 < strength.value < math.inf:
            raise ValueError(f"a strength of {strength.value:g} T is not positive and finite")
        if not inclination.is_unknown and abs(inclination.value) > math.pi:
            raise ValueError(f"an inclination of {inclination.value:g} is not in radians")
        if self.declination is not None and not abs(self.declination) <= math.pi:
            raise ValueError(f"a declination of {self.declination:g} is not in radians")
        if not 0.0 <= self.declination_sigma < math.inf:
            raise ValueError("the sigma of a declination is a number of zero or more")

    @property
    def is_complete(self) -> bool:
        """Whether both strength and inclination are known."""
        return not (self.strength.is_unknown or self.inclination.is_unknown)

    @property
    def is_known(self) -> bool:
        """Whether the declination is known as well."""
        return self.is_complete and self.declination is not None

    @property
    def declination_belief(self) -> Belief:
        """The declination with its sigma, radians."""
        if self.declination is None:
            return Belief.unknown()
        return Belief(self.declination, self.declination_sigma)

    def to_magnetic(self, is_true: bool) -> float | None:
        """Return the angle to add to a heading for magnetic north, radians; None if not known."""
        return self.declination if is_true else 0.0


@dataclass(frozen=True)
class SoftIron:
    """Prior of the soft iron beyond the known gains.

    The residual soft iron is a symmetric 3 x 3 matrix E in body axes, `m = K R_n (I + E) ...`.
    """

    sigma_diagonal: float = 0.03
    sigma_cross: float = 0.02
    """Standard deviations of the elements on and off the diagonal, dimensionless. If both are zero,
    there is no soft iron; otherwise the smoother uses its own prior."""
    always: bool = False  # has no effect on the smoother, which always estimates it

    def __post_init__(self) -> None:
        if not all(0.0 <= each < math.inf for each in (self.sigma_diagonal, self.sigma_cross)):
            raise ValueError("the sigmas of soft iron must be finite, and zero or more")

    @classmethod
    def none(cls) -> SoftIron:
        """Return the belief that there is no soft iron beyond the known gains."""
        return cls(0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Mounting:
    """Nominal mounting of the magnetometer: known gains and pose."""

    gains: FloatArray = field(default_factory=lambda: np.ones(3))
    """Known soft-iron gains K along the sensor's axes, dimensionless, positive. Shape (3,)."""
    pose: FloatArray = field(default_factory=lambda: np.eye(3))
    """Nominal pose of the magnetometer in the IMU's frame, sensor axes to body axes
    (`rotation_from_rpy` of the URDF's origin). Shape (3, 3)."""
    yaw_sigma: float = math.radians(5.0)
    """Sigma of the true pose's yaw about the nominal one, radians. One turn determines roll and
    pitch; only turns at different tilts determine the yaw."""
    forward: FloatArray = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    """Unit vector along the front of the vehicle in the IMU's axes. Shape (3,)."""
    upward: FloatArray = field(default_factory=lambda: Z)
    """Unit vector to the top of the vehicle in the IMU's axes. Shape (3,)."""

    def __post_init__(self) -> None:
        freeze(self, gains=(3,), pose=(3, 3), forward=(3,), upward=(3,))
        if (self.gains <= 0.0).any():
            raise ValueError("soft-iron gains must be positive")
        if not np.allclose(self.pose @ self.pose.T, np.eye(3), atol=1e-3):
            raise ValueError("the rows of a mounting's pose must be orthonormal")
        for name, vector in (("front", self.forward), ("top", self.upward)):
            if not abs(float(np.linalg.norm(vector)) - 1.0) < 1e-3:
                raise ValueError(f"the {name} of a vehicle is a unit vector")
        if not 0.0 < self.yaw_sigma < math.inf:
            raise ValueError("the sigma of the mounting's yaw must be positive and finite")

    @property
    def matrix(self) -> FloatArray:
        """K times the nominal rotation from body to sensor axes, shape (3, 3)."""
        return np.asarray(self.gains[:, None] * self.pose.T)

    @property
    def to_body(self) -> FloatArray:
        """From sensor to nominal body axes, gains removed; the inverse of `matrix`, (3, 3)."""
        return np.asarray(self.pose / self.gains)

    def in_axes(self, rotation: FloatArray) -> Mounting:
        """Return the same mounting for rotated axes of the IMU's frame."""
        pose, forward, upward = (rotation @ each for each in (self.pose, self.forward, self.upward))
        return replace(self, pose=pose, forward=forward, upward=upward)

    def lean(self, up: FloatArray) -> float:
        """Return the angle of up (3,) to the body's z or the vehicle's top, the smaller, radians.

        A wrong description of the top does no harm where the IMU's z points up.
        """
        return min(angle_between(up, each) for each in (Z, self.upward))


@dataclass(frozen=True)
class Knowledge:
    """Prior knowledge that a method uses in addition to the samples.

    The raw field is `m_raw = K R_n (I + E) R m_body + h + noise`: K and R_n from `mounting`,
    E the residual soft iron, R = (rotation_from_rpy(roll, pitch, 0))^T the installation error.
    """

    reference: ReferenceField = field(default_factory=ReferenceField)
    mounting: Mounting = field(default_factory=Mounting)
    soft_iron: SoftIron = field(default_factory=SoftIron)
    exact_sensors: bool = False
    """Whether the sensors have no errors except those above and white noise, as in a simulation.
    Real sensors have others, which the smoother estimates."""

    @property
    def upward(self) -> FloatArray:
        """Unit vector to the top of the vehicle in the IMU's axes, shape (3,)."""
        return self.mounting.upward

    def in_axes(self, rotation: FloatArray) -> Knowledge:
        """Return the same knowledge for rotated body axes."""
        return replace(self, mounting=self.mounting.in_axes(rotation))


def knowledge_of(
    strength_ut: float = math.nan,
    strength_sigma_ut: float = STRENGTH_SIGMA_UT,
    inclination_deg: float = math.nan,
    inclination_sigma_deg: float = INCLINATION_SIGMA_DEG,
    declination_deg: float = math.nan,
    declination_sigma_deg: float = DECLINATION_SIGMA_DEG,
) -> Knowledge:
    """Return the knowledge of the field, in the suffixes' units, with the nominal mounting.

    NaN means unknown.
    """
    strength, inclination = Belief.unknown(), Belief.unknown()
    if not math.isnan(strength_ut):
        strength = Belief(strength_ut * 1e-6, strength_sigma_ut * 1e-6)
    if not math.isnan(inclination_deg):
        inclination = Belief(math.radians(inclination_deg), math.radians(inclination_sigma_deg))
    declination = None if math.isnan(declination_deg) else math.radians(declination_deg)
    declination_sigma = 0.0 if declination is None else math.radians(declination_sigma_deg)
    return Knowledge(ReferenceField(strength, inclination, declination, declination_sigma))
