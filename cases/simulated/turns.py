"""Simulated turns: the motion of a robot, and the measurements of its sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.core.geometry.rotations import (
    exp_rotations,
    minimal_rotation,
    rotation_about,
    rotation_from_rpy,
    rotation_vectors,
    rpy_from_rotation,
    skew,
)
from magcal_ros.core.samples.window import Window
from magcal_ros.core.simulation import UP_ENU, Robot


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
    """Disturbances while the robot turns."""

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
    """Simulate the robot's sensors during a motion.

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
