"""A simulated robot: the truth, and what its sensors measure."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.arrays import FloatArray, frozen_array
from magcal_ros.core.geometry.attitude import (
    STANDARD_GRAVITY,
    field_in_enu,
    wrap_angle,
    yaw_from_up_and_field,
)
from magcal_ros.core.geometry.rotations import (
    exp_rotations,
    minimal_rotation,
    rotation_about,
    rotation_from_rpy,
    rotation_vectors,
    rpy_from_rotation,
    skew,
)
from magcal_ros.core.knowledge import (
    Belief,
    Knowledge,
    Mounting,
    ReferenceField,
)
from magcal_ros.core.samples.window import Window

DEGREE = math.pi / 180.0
UP_ENU: FloatArray = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Robot:
    """The true field, the true compass errors and the sensors' noise.

    The raw field is `K R_n (I + E) R m_body + h + noise`, as in `Knowledge`.
    """

    strength: float = 50e-6
    inclination: float = 60.0 * DEGREE
    declination: float = 0.0
    """The field where the robot stands: tesla, radians, radians."""
    roll: float = 3.0 * DEGREE
    pitch: float = -4.0 * DEGREE
    yaw: float = 0.0
    """Installation error in radians, a pose as in a URDF. Yaw is for trying what one turn cannot
    show."""
    hard_iron: FloatArray = field(default_factory=lambda: np.array([30e-6, -20e-6, 25e-6]))
    """Tesla, in the magnetometer's axes. Shape (3,)."""
    mounting: Mounting = field(default_factory=Mounting)
    """The known gains and the nominal pose."""
    soft_iron: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    """E, the soft iron nobody told the estimator of. Shape (3, 3)."""
    noise_field: float = 0.5e-6
    noise_force: float = 0.01 * STANDARD_GRAVITY
    noise_rate: float = 1e-3
    """Standard deviations per axis and sample: tesla, m/s², rad/s."""
    gyro_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    """rad/s. Shape (3,)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "hard_iron", frozen_array(self.hard_iron, (3,), "hard iron"))
        object.__setattr__(self, "soft_iron", frozen_array(self.soft_iron, (3, 3), "soft iron"))
        object.__setattr__(self, "gyro_bias", frozen_array(self.gyro_bias, (3,), "gyro bias"))

    @property
    def distortion(self) -> FloatArray:
        """The matrix from the field in body axes to the raw field, shape (3, 3)."""
        installation = rotation_from_rpy(self.roll, self.pitch, self.yaw).T
        return np.asarray(self.mounting.matrix @ (np.eye(3) + self.soft_iron) @ installation)

    @property
    def field_enu(self) -> FloatArray:
        """The reference field in true ENU axes, tesla, shape (3,)."""
        return field_in_enu(self.strength, self.inclination, self.declination)

    @property
    def true_correction(self) -> Correction:
        """The correction a perfect calibration would find."""
        return Correction(np.asarray(np.linalg.inv(self.distortion)), self.hard_iron)

    def knowledge(self, strength_sigma: float = 0.0, inclination_sigma: float = 0.0) -> Knowledge:
        """Return what an owner of this robot knows: reference field, mounting, faultless sensors.

        Parameters
        ----------
        strength_sigma, inclination_sigma : float
            Tesla and radians; zero for exactly known, infinite for unknown.
        """
        reference = ReferenceField(
            Belief(self.strength, strength_sigma),
            Belief(self.inclination, inclination_sigma),
            self.declination,
        )
        return Knowledge(reference, self.mounting, exact_sensors=True)

    def raw_field(self, field_body: FloatArray) -> FloatArray:
        """Return the noise-free raw field (n, 3) for the field in body axes (n, 3), tesla."""
        return np.asarray(field_body @ self.distortion.T + self.hard_iron)


@dataclass(frozen=True, eq=False)
class Motion:
    """Attitudes over time."""

    time: FloatArray
    """Seconds. Shape (n,)."""
    attitude: FloatArray
    """Rotations from ENU to body axes. Shape (n, 3, 3)."""

    @property
    def angular_rate(self) -> FloatArray:
        """rad/s in body axes at each moment, shape (n, 3).

        From the rotations between neighbours, which are the rate's means over each step, by the
        fourth-order formula for evenly spaced steps.
        """
        if len(self.time) < 2:
            return np.zeros((len(self.time), 3))
        back = self.attitude[:-1] @ np.swapaxes(self.attitude[1:], 1, 2)
        mean = rotation_vectors(back) / np.diff(self.time)[:, None]
        padded = np.pad(mean, ((2, 2), (0, 0)), mode="reflect", reflect_type="odd")
        return np.asarray((7.0 * (padded[1:-2] + padded[2:-1]) - padded[:-3] - padded[3:]) / 12.0)


def turn(
    *,
    arc: float = 2.0 * math.pi,
    samples: int = 500,
    duration: float = 15.0,
    axis: FloatArray = UP_ENU,
    start_rpy: tuple[float, float, float] = (0.0, 0.0, 0.0),
    wobble: FloatArray | None = None,
) -> Motion:
    """Turn about one axis that is fixed in the body and in the world.

    Parameters
    ----------
    arc : float
        Radians, counter-clockwise about `axis` where positive. A full turn leaves out its last
        sample, which would repeat the first.
    samples : int
        Number of moments, at equal angles.
    duration : float
        Seconds.
    axis : array_like, shape (3,)
        The axis in body axes.
    start_rpy : tuple of float
        Attitude at the start: roll, pitch, ENU yaw in radians.
    wobble : ndarray, shape (samples, 3), optional
        Small rotation vector in body axes added at each moment, radians.

    Returns
    -------
    Motion
    """
    share = np.arange(samples) / (samples if abs(arc) >= 2.0 * math.pi else max(samples - 1, 1))
    direction = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    attitude = rotation_about(direction, -arc * share) @ rotation_from_rpy(*start_rpy).T
    if wobble is not None:
        attitude = exp_rotations(wobble) @ attitude
    return Motion(duration * share, attitude)


def slope_rpy(tilt: float, azimuth: float, heading: float) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a robot that stands on a slope.

    Parameters
    ----------
    tilt : float
        Radians of the slope.
    azimuth : float
        ENU direction to which the slope rises, radians.
    heading : float
        Turn of the robot on the slope, radians; zero is ENU east before the slope is tilted.
    """
    normal = [-math.sin(tilt) * math.cos(azimuth), -math.sin(tilt) * math.sin(azimuth)]
    slope = minimal_rotation(UP_ENU, np.array([*normal, math.cos(tilt)]))
    return rpy_from_rotation(slope @ rotation_from_rpy(0.0, 0.0, heading))


def smooth_wobble(
    rng: np.random.Generator,
    samples: int,
    duration: float,
    rms: float,
    band: tuple[float, float] = (0.5, 2.0),
    axis: FloatArray = UP_ENU,
) -> FloatArray:
    """Draw a band-limited wobble across `axis`.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    samples, duration : int, float
        Length of the turn, in moments and seconds.
    rms : float
        Radians, expected root mean square of each of the two components.
    band : tuple of float
        Lowest and highest frequency, hertz.
    axis : array_like, shape (3,)
        The turn's axis in body axes.

    Returns
    -------
    ndarray, shape (samples, 3)
        Rotation vectors for `turn`.
    """
    # Four times the length, of which a quarter is used: the ends do not meet.
    frequency = np.fft.rfftfreq(4 * samples, duration / samples)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    spectrum = inside * (
        rng.standard_normal((2, len(frequency))) + 1j * rng.standard_normal((2, len(frequency)))
    )
    signal = np.fft.irfft(spectrum, 4 * samples, axis=1)
    expected = math.sqrt(4.0 * inside.sum()) / (4 * samples)
    signal = signal[:, :samples] / max(expected, 1e-300) * rms
    k = skew(np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis))
    across = np.linalg.svd(k)[0][:, :2]
    return np.asarray(signal.T @ across.T)


@dataclass(frozen=True)
class Trouble:
    """What else goes wrong while the robot turns."""

    outliers: float = 0.0
    """Share of field samples hit at random."""
    outlier_size: float = 15e-6
    """Tesla, standard deviation per axis of such a hit."""
    disturbance: float = 0.0
    """Tesla, peak of a field fixed in the world that comes and goes once (a Hann bump)."""
    disturbance_share: float = 0.2
    """Share of the turn that it lasts."""
    vibration: float = 0.0
    """m/s², extra noise of the accelerometer per axis."""


def measure(
    robot: Robot,
    motion: Motion,
    rng: np.random.Generator,
    *,
    gyro: bool = False,
    trouble: Trouble = Trouble(),
) -> Window:
    """Let the robot's sensors watch a motion.

    Parameters
    ----------
    robot : Robot
        Truth and noise.
    motion : Motion
        Where it looks, and when.
    rng : numpy.random.Generator
        Source of chance.
    gyro : bool
        Whether there is one.
    trouble : Trouble
        Outliers, a passing disturbance, vibration.

    Returns
    -------
    Window
    """
    n = len(motion.time)
    field_body = motion.attitude @ robot.field_enu + _passing_field(motion, rng, trouble)
    raw = robot.raw_field(field_body) + robot.noise_field * rng.standard_normal((n, 3))
    if trouble.outliers > 0.0:
        hit = rng.random(n) < trouble.outliers
        raw[hit] += trouble.outlier_size * rng.standard_normal((int(hit.sum()), 3))
    force = STANDARD_GRAVITY * (motion.attitude @ UP_ENU)
    shake = math.hypot(robot.noise_force, trouble.vibration)
    force = force + shake * rng.standard_normal((n, 3))
    rate = None
    if gyro:
        rate = motion.angular_rate + robot.gyro_bias
        rate = rate + robot.noise_rate * rng.standard_normal((n, 3))
    return Window(motion.time, raw, force, rate)


def _passing_field(motion: Motion, rng: np.random.Generator, trouble: Trouble) -> FloatArray:
    n = len(motion.time)
    extra = np.zeros((n, 3))
    length = int(trouble.disturbance_share * n)
    if trouble.disturbance <= 0.0 or length < 1:
        return extra
    first = int(rng.integers(0, n - length + 1))
    direction = rng.standard_normal(3)
    direction *= trouble.disturbance / np.linalg.norm(direction)
    bump = np.hanning(length + 2)[1:-1, None]
    extra[first : first + length] = bump * (motion.attitude[first : first + length] @ direction)
    return extra


def trial_attitudes(tilt: float = 10.0 * DEGREE, headings: int = 24) -> FloatArray:
    """Return attitudes ENU to body at all headings for nine tilts, shape (headings, 9, 3, 3).

    The tilts are roll and pitch in {-tilt, 0, tilt}; index 4 is level.
    """
    yaws = np.arange(headings) * (2.0 * math.pi / headings)
    steps = (-tilt, 0.0, tilt)
    return np.array([[rotation_from_rpy(r, p, y).T for r in steps for p in steps] for y in yaws])


LEVEL_TILT = 4
"""Index of the level tilt in `trial_attitudes`."""


def heading_errors(
    correction: Correction, robot: Robot, attitudes: FloatArray | None = None
) -> FloatArray:
    """Return the yaw error that a correction leaves at known attitudes with perfect sensors.

    Parameters
    ----------
    correction : Correction
        What was found.
    robot : Robot
        The truth.
    attitudes : ndarray, shape (..., 3, 3), optional
        ENU to body; `trial_attitudes` unless given.

    Returns
    -------
    ndarray, shape (...)
        Radians in (-pi, pi], estimated minus true yaw (both to the robot's magnetic north).
    """
    poses = trial_attitudes() if attitudes is None else attitudes
    up, field_body = poses @ UP_ENU, poses @ robot.field_enu
    found = yaw_from_up_and_field(up, correction.apply(robot.raw_field(field_body)))
    return wrap_angle(found - yaw_from_up_and_field(up, field_body))
