"""From one raw field sample and the up vector of its moment to a yaw with a variance.

This is the path of every message, so it computes in plain floats: on three numbers they are
several times faster than numpy arrays.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import PARAMETERS, MotorField, MotorState
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import true_yaw
from magcal_ros.core.geometry.vec3 import Triple, cross, dot, length, minus, propagated
from magcal_ros.core.heading.motor_field_filter import MotorCovariance, MotorFieldFilter
from magcal_ros.core.heading.motor_inputs import MotionDetector
from magcal_ros.core.knowledge import UNKNOWN_YAW
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import FieldSample
from magcal_ros.core.up.follower import Up, UpFollower

Quaternion = tuple[float, float, float, float]

CERTAIN = (0.0,) * (PARAMETERS + 1)  # `Heading.lasting` of a compass without errors
SMALLEST_LEVEL_SHARE = 0.02  # below this share of level field (a dip of 89°) there is no yaw

SMALLEST_FORWARD = 1e-6
"""Least squared level component of body x; nose up or down, roll and yaw cannot be separated."""


class Heading(NamedTuple):
    """Attitude by gravity and field at one moment: radians, and variances in rad²."""

    roll: float
    pitch: float
    yaw: float  # ENU, to magnetic north
    tilt_variance: float  # of up in either direction; roll's is over cos² pitch
    yaw_variance: float
    by_east: float  # yaw error by an error of up about east
    by_north: float  # the same about north
    noise_variance: float = 0.0  # part of the yaw's variance by white noise of the sample
    lasting_variance: float = 0.0  # part of the yaw's variance by the calibration
    # (13,): yaw error (radians) by each of thirteen independent unit errors; the last is constant
    lasting: tuple[float, ...] = CERTAIN

    @property
    def variance_by_tilt(self) -> float:
        """The remaining part of the yaw's variance, by the error of up and the motors' field."""
        return max(0.0, self.yaw_variance - self.noise_variance - self.lasting_variance)

    def quaternion(self, declination: float = 0.0) -> Quaternion:
        """Return x, y, z, w of the attitude body to ENU, to true north if declination is given."""
        return quaternion_from_rpy(self.roll, self.pitch, true_yaw(self.yaw, declination))

    def covariance(self, north_variance: float = 0.0) -> tuple[float, ...]:
        """Return the row-major 3 x 3 covariance of roll, pitch and yaw, rad².

        `north_variance` is the variance of the direction of north, rad²: that of the declination
        for true north.
        """
        t, cosine, sine = self.tilt_variance, math.cos(self.yaw), math.sin(self.yaw)
        forward = max(math.cos(self.pitch) ** 2, SMALLEST_FORWARD)
        ry = t * (self.by_east * cosine + self.by_north * sine) / math.sqrt(forward)
        py = t * (self.by_north * cosine - self.by_east * sine)
        return (t / forward, 0.0, ry, 0.0, t, py, ry, py, self.yaw_variance + north_variance)


def quaternion_from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return x, y, z, w of Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def yaw_between(north: Triple, other: Triple, up: Triple) -> float:
    """Return the yaw by north as `other` minus the yaw by `north`, radians; `north` is level."""
    # North that lies further to the left is a yaw further to the right.
    return -math.atan2(dot(cross(north, other), up), dot(north, other))


def levelled(vector: Triple, up: Triple) -> Triple | None:
    """Return the direction of a vector's level part; None if that is too small."""
    rise = dot(vector, up)
    level = (vector[0] - rise * up[0], vector[1] - rise * up[1], vector[2] - rise * up[2])
    size = length(level)
    if size <= SMALLEST_LEVEL_SHARE * length(vector):
        return None
    return (level[0] / size, level[1] / size, level[2] / size)


class Compass:
    """Applies a calibration, and the field of `motors`, to successive messages."""

    def __init__(self, calibration: Calibration) -> None:
        self.calibration = calibration
        a, h = calibration.correction.matrix, calibration.correction.hard_iron
        self._a: tuple[float, ...] = tuple(float(value) for value in a.ravel())
        self._h: tuple[float, ...] = tuple(float(value) for value in h)
        variances, directions = np.linalg.eigh(_body_covariance(calibration))
        self._errors = directions * np.sqrt(np.maximum(variances, 0.0))
        self.motors: MotorField | None = None
        self._now: MotorFieldFilter | None = None
        self._noise = calibration.noise_field**2 * np.asarray(a @ a.T)
        local = calibration.evidence.figure(Figure.LOCAL_FIELD, 0.0)
        self._local = local**2 * np.asarray(a @ a.T)
        self._tilt_variance = calibration.noise_up**2
        x, y, z = calibration.upward.tolist()
        self.upward: Triple = (x, y, z)
        self.latency = calibration.evidence.figure(Figure.LATENCY, 0.0)
        """Seconds by which the stamps of the field are late, against those of the gyro."""
        self.use_motors(calibration.motors)

    def use_motors(self, motors: MotorField | None) -> None:
        """Use another estimate of the motors' field from now on."""
        self.motors = motors
        if motors is not None:
            if self._now is None:
                own = level_field_covariance(self.calibration)
                matrix = self.calibration.correction.matrix
                self._now = MotorFieldFilter(motors, matrix, own, self._noise)
            self._now.use(motors)

    def without_motors(self, raw: Triple, motor_state: MotorState) -> Triple:
        """Return a raw field, tesla, without the motors' field."""
        if self.motors is None:
            return raw
        x, y, z = (self.motors.values(motor_state) @ self.motors.gain).tolist()
        return minus(raw, (x, y, z))

    def correct(self, raw: Triple) -> Triple:
        """Return the field of a robot at rest in body axes, tesla."""
        a, h = self._a, self._h
        x, y, z = raw[0] - h[0], raw[1] - h[1], raw[2] - h[2]
        return (
            a[0] * x + a[1] * y + a[2] * z,
            a[3] * x + a[4] * y + a[5] * z,
            a[6] * x + a[7] * y + a[8] * z,
        )

    def at_rest(
        self, stamp: float, raw: Triple, rate: Triple | None, motor_state: MotorState
    ) -> tuple[Triple, MotorCovariance | None]:
        """Return the corrected field without the motors' field, and its errors.

        The stamps increase (`MotorFieldFilter.add`). The errors are None if no motors are known.
        """
        field = self.correct(raw)
        return (
            (field, None) if self._now is None else self._now.add(stamp, field, rate, motor_state)
        )

    def heading(
        self,
        field: Triple,
        force: Triple,
        tilt_variance: float | None = None,
        motors: MotorCovariance | None = None,
    ) -> Heading | None:
        """Return the attitude for a corrected field and a specific force in body axes.

        None if gravity or the level part of the field is too small for a direction.

        `field` is in tesla, `force` in m/s², or up as a unit vector. `tilt_variance` is the
        variance of up in either direction, rad², by default that of a single accelerometer reading.
        `motors` are the errors of the motors' field that was subtracted.

        In magnetic ENU axes let body x be (xe, xn, xu) and the field (0, mn, mu). A small error of
        the up vector, a rotation (pe, pn) about east and north, causes a yaw error
        pe * (-xe xu / l²) + pn * (mu / mn - xn xu / l²), with l² = xe² + xn².
        The roll error is (pe cos yaw + pn sin yaw) / l, the pitch error pn cos yaw - pe sin yaw.
        """
        fx, fy, fz = force
        mx, my, mz = field
        gravity = math.sqrt(fx * fx + fy * fy + fz * fz)
        size = math.sqrt(mx * mx + my * my + mz * mz)
        if gravity < 0.1 or size <= 0.0:
            return None
        ux, uy, uz = fx / gravity, fy / gravity, fz / gravity
        ex, ey, ez = my * uz - mz * uy, mz * ux - mx * uz, mx * uy - my * ux
        level = math.sqrt(ex * ex + ey * ey + ez * ez)
        if level < SMALLEST_LEVEL_SHARE * size:
            return None
        ex, ey, ez = ex / level, ey / level, ez / level
        nx = uy * ez - uz * ey
        yaw = math.atan2(nx, ex)
        roll, pitch = math.atan2(uy, uz), math.atan2(-ux, math.hypot(uy, uz))
        forward = max(1.0 - ux * ux, SMALLEST_FORWARD)
        rise = mx * ux + my * uy + mz * uz
        by_east = -ex * ux / forward
        by_north = rise / level - nx * ux / forward
        tilt = self._tilt_variance if tilt_variance is None else tilt_variance
        variance = tilt * (by_east * by_east + by_north * by_north)
        g, q = np.array((ex / level, ey / level, ez / level)), np.array((mx, my, mz, -1.0))
        errors = (g[:, None] * q).ravel() @ self._errors
        new, passing = self._noise, self._local
        if motors is not None:
            new, passing = motors.noise, passing + motors.lasting
        noise, other = float(g @ new @ g), float(g @ passing @ g)
        lasting = float(errors @ errors)
        variance += lasting + noise + other
        own = variance, by_east, by_north, noise, lasting, (*errors.tolist(), 0.0)
        return Heading(roll, pitch, yaw, tilt, *own)


def level_field_covariance(calibration: Calibration) -> FloatArray:
    """Return the covariance of the corrected field by that of the calibration, (3, 3), tesla².

    It is the mean over all headings on the level. A turn determines the sum of hard iron and
    rotated vertical field better than each of them.
    """
    whole = _body_covariance(calibration).reshape(3, 4, 3, 4)
    level = calibration.strength * math.cos(calibration.inclination)
    upward = -calibration.strength * math.sin(calibration.inclination)
    squares = np.diag([0.5 * level**2, 0.5 * level**2, upward**2, 1.0])
    squares[2, 3] = squares[3, 2] = -upward
    return np.asarray(np.einsum("iajb,ab->ij", whole, squares))


def _body_covariance(calibration: Calibration) -> FloatArray:
    """Transform the covariance from (A, h) to (G, b) with an error dm = G m_body - b.

    A change of A by dA and of h by dh changes the corrected field by dA A^-1 m - A dh, so
    G = dA A^-1 and b = A dh. The order is row by row, (G00, G01, G02, b0, G10, ...).
    """
    a = calibration.correction.matrix
    inverse = np.linalg.inv(a)
    carry = np.zeros((PARAMETERS, PARAMETERS))
    for row in range(3):
        carry[4 * row : 4 * row + 3, 3 * row : 3 * row + 3] = inverse.T
        carry[4 * row + 3, 9:] = a[row]
    return np.asarray(carry @ calibration.covariance @ carry.T)


class CompassReading(NamedTuple):
    """A field sample, corrected by a calibration."""

    stamp: float  # of the field message, seconds
    field: Triple  # corrected, in the body axes of the stamp, tesla
    up: Up | None  # of the same moment; None if no IMU sample is near enough
    heading: Heading | None  # None if field or up have no direction
    rate: Triple | None  # without the gyro's bias, rad/s, body axes; None without a usable gyro
    old_value_variance: float = 0.0
    """Part of the yaw's variance because the value of the field may be an old one, rad²."""
    measured: Triple = (math.nan, math.nan, math.nan)
    """The same field in the body axes of its measurement, which is earlier by a latency."""


class CompassReader:
    """Reads compasses: up comes from a follower, the motors' state from it, wheels and battery.

    The follower has received all messages up to the stamp of a field sample, in seconds. `inputs`
    gives the speed (m/s) and the current (A) at a stamp, NaN if unknown.
    """

    def __init__(
        self,
        follower: UpFollower,
        inputs: Callable[[float], tuple[float, float]] = lambda _: (math.nan, math.nan),
    ) -> None:
        self._follower, self._inputs, self.detector = follower, inputs, MotionDetector()

    def motor_state(self, stamp: float, compass: Compass) -> MotorState:
        """Return the state of the motors, with the current beyond the compass's reference."""
        still, rate = self._follower.is_at_rest, self._follower.rate
        reference = math.nan if compass.motors is None else compass.motors.reference
        inputs = *self._inputs(stamp), reference, compass.upward
        return self.detector.at(stamp, rate, still, *inputs)

    def read(
        self,
        compass: Compass,
        sample: FieldSample,
        max_gap: float = STREAMS.max_gap,
        turned_unchanged: float = 0.0,
        up: Up | None = None,
    ) -> CompassReading:
        """Return a field sample, corrected by a compass, without the field of the motors.

        `max_gap` is as for `UpFollower.at`, which gives `up` by default. `turned_unchanged` is the
        angle by which the robot has turned since this value of the field first came, radians. A
        magnetometer that is frozen, coarse or read too often repeats an old value, so the error of
        the yaw may be as large.
        """
        follower, stamp, heading = self._follower, sample.stamp, None
        up, rate = up or follower.at(stamp, max_gap), follower.rate
        measured, motors = compass.correct(sample.field), None
        if compass.motors is not None:
            state = self.motor_state(stamp, compass)
            measured, motors = compass.at_rest(stamp, sample.field, rate, state)
        field = propagated(measured, follower.turn_between(stamp - compass.latency, stamp))
        if up is not None:
            heading = compass.heading(field, up.direction, up.variance, motors)
        old = min(turned_unchanged**2, UNKNOWN_YAW)
        if heading is not None and old:
            heading = heading._replace(yaw_variance=heading.yaw_variance + old)
        return CompassReading(stamp, field, up, heading, rate, old, measured)
