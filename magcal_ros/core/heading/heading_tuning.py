"""The assumptions of this room, by subject: each number with its unit and its reason."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import IDENTITY
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.knowledge import STREET_LENGTH
from magcal_ros.core.up.filter import GYRO


@dataclass(frozen=True)
class MotionDetectorTuning:
    """When a robot moves, and how well the inputs determine the motors' field."""

    rate: float = 0.03  # rad/s from which it turns
    speed: float = 0.01  # m/s from which it drives: below a step of a wheel's encoder
    idle: float = 5.0  # seconds over which the current at rest is averaged
    body_length: float = 4.0
    """Correlation time of the motors' residual field, and of the body's coloured noise, seconds."""
    unseen: float = 0.1
    """Relative residual of the motors' field along the field by the inputs, median. Without
    reported currents, those of wheels vary by a fifth to a third, with the floor and in curves; a
    field that is switched with the motors hardly varies."""
    late_share: float = 0.03  # fraction of the time in which motors start or stop undetected
    longest: float = 0.5  # longest such time, seconds
    latency: float = 0.2  # largest usual latency of a speed or a current, seconds


@dataclass(frozen=True)
class DisturbanceTuning:
    """How a disturbed field is detected, and how far it may turn the yaw."""

    strength: float = 0.02  # relative sigma of a good field's strength from place to place
    amplitude: float = 0.01
    """Prior size of the local disturbance per axis, over the field's strength: 0.5 µT, as on open
    land. The learnt size is at least half of it."""
    amplitude_memory: float = 100.0
    """Seconds over which the amplitude is learnt, and that of the motors' residual field: a few
    hundred metres of road."""


@dataclass(frozen=True)
class FusionTuning:
    """The Kalman filter on yaw, gyro bias and the field's disturbance."""

    bias_sigma: float = 0.001  # least sigma of the remaining bias about up, rad/s
    rest_turn: float = 1e-4  # rad/s, median turn rate of a robot that seems to rest
    rest_time: float = 10.0  # correlation time of this turn rate, seconds
    spread: float = 1.5
    """Standard deviation of the natural logarithm of three sizes: of this turn rate (wheels stand,
    boats swing), of a gyro's random walk over the usual one, and of `heading_error_time`."""
    tilt_tau: float = 3.0
    """Correlation time of errors by tilt, seconds. A good field that contradicts the yaw for longer
    overrules it."""
    noise_tau: float = 0.5
    """The same for the field's noise and for small iron near the path; strength and dip of the
    field are averaged over it."""
    small_iron: float = 0.3  # fraction of the disturbance's variance that changes within two metres
    moving_tau: float = 20.0
    """Correlation time of the disturbance of a moving robot, seconds. The correlation length of
    streets is 25 to 30 m: 4 s in a car and 37 s at walking pace. Too short a time would make the
    variance of the yaw too small."""
    standing_tau: float = 300.0  # the same at rest
    heading_tau: float = 2.0  # seconds of headings from another device that are joined
    heading_error_time: float = 1.0
    """Correlation time of the error of such a heading, seconds, median. Noise is white, reflections
    last for a minute."""
    heading_drift: float = 7e-4  # rad/s per root second: .3°/s within a minute
    """Random walk of the drift rate of such headings, by reflections or a wrong ambiguity. It looks
    like a random walk of the gyro's bias."""
    drift_time: float = 100.0  # correlation time of the drift's rate and angle, seconds
    drift_jump: float = 0.1  # radians of error when headings come back from beyond the gate
    drift_odds: tuple[float, float] = (0.1, 0.01)
    """Prior odds that a device drifts at random, and that it integrates the bias of a gyro."""
    integrated_rate: float = 2e-3  # rad/s, usual bias of a gyro that a device integrates
    heading_gate: float = 4.0  # largest normalised innovation of a heading
    start: float = 5.0  # seconds from the start in which a disturbance may still be detected


@dataclass(frozen=True)
class PlaceFieldTuning:
    """How the field of a place changes in the axes of a robot."""

    field: float = 100.0  # prior sigma of the field before the first sample, µT
    street: float = 1.0  # size of the local disturbance, µT per axis, median
    block: float = 0.2  # seconds whose samples are averaged, and between slow updates
    latency: float = 0.01  # seconds between gyro and field
    beside: float = 0.15  # distance of the magnetometer from the pivot, metres
    unknown_speed: float = 0.3  # m/s of a moving robot without a known speed

    def path(self, speed: float, rate: Triple) -> float:
        """Return the speed of the magnetometer, m/s, for that of the robot (or NaN) and a rate."""
        known = self.unknown_speed if math.isnan(speed) else abs(speed)
        return math.hypot(known, self.beside * math.hypot(*rate))

    def change(
        self, place: FloatArray, turned: FloatArray, faster: FloatArray, path: float, seconds: float
    ) -> FloatArray:
        """Return the process noise of the field of the place, µT², shape (3, 3).

        The local disturbance is not included (`path_variance`). `place` (3,) is the field in µT,
        body axes, `turned` (3,) the rotation of the robot, radians, `faster` (3,) the change of the
        turn rate, rad/s, and `path` the path of the magnetometer, metres, zero at rest.
        """
        lost = GYRO.walk_variance(math.sqrt(float(turned @ turned)), seconds * (path > 0.0))
        lost += self.latency**2 * float(faster @ faster)
        # At rest, vehicles pass by.
        passing = 2.0 * DISTURBANCE.amplitude**2 * seconds / FUSION.standing_tau
        square = float(place @ place)
        return np.asarray((lost + passing) * square * IDENTITY - lost * place[:, None] * place)

    def path_variance(self, path: float) -> float:
        """Return the process noise by a path in metres, for a local disturbance of 1 µT, µT²."""
        return 2.0 * path / STREET_LENGTH


@dataclass(frozen=True)
class VehicleYawTuning:
    """When a sensor counts as misaligned, and a yaw found by driving is used."""

    useful: float = math.radians(2.0)
    """Radians of sigma below which a yaw is applied; smaller differences are not reported."""
    lost: float = math.radians(10.0)  # radians of sigma beyond which a course is not used
    far_off: float = math.radians(15.0)
    """Difference of described and found yaw from which the user must correct the description."""


MOTION, PLACE_FIELD, DISTURBANCE, FUSION, VEHICLE_YAW = (
    MotionDetectorTuning(),
    PlaceFieldTuning(),
    DisturbanceTuning(),
    FusionTuning(),
    VehicleYawTuning(),
)
