"""The twelve numbers of a fit, with their covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.correction import PARAMETERS, Correction, MotorField, MotorInput
from magcal_ros.core.calibration.heading_sigma import (
    heading_jacobian,
    rms_heading_difference,
    rms_sigma,
)
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit
from magcal_ros.core.geometry.rotations import exp_rotations
from magcal_ros.core.smoother.factors import distortion
from magcal_ros.core.smoother.fit import Fit
from magcal_ros.core.smoother.state import State
from magcal_ros.core.smoother.unknowns import (
    AT,
    BEYOND_USUAL,
    CURRENT_LATE,
    EARTH,
    MICROTESLA,
    MOTORS,
    SHARED,
)

INPUTS = MotorInput.MOVING, MotorInput.TURN_RATE, MotorInput.CURRENT
"""The inputs of the motors' unknowns (`MOTORS`); the current is the last, as it may be unknown."""
OF_CORRECTION = "iron", "installation", "axes", "turned", "soft_iron", "shielding", "force_offset"
"""Groups of shared unknowns on which the twelve numbers depend."""
ONE_WAY = 0.8  # mean sign of the turn rate beyond which a turn counts as one way


@dataclass(frozen=True, eq=False)
class Posterior:
    """A calibration with its covariance, SI units."""

    numbers: FloatArray
    """The twelve, then the motors' field while moving, per turn rate and, with a battery, per
    ampere (`INPUTS`). Shape (18,) or (21,)."""
    joint: FloatArray  # their covariance. Shape (18, 18) or (21, 21).
    by_offset: FloatArray
    """Part of the covariance that is due to the accelerometer's offset. Shape (12, 12)."""
    strength: float
    inclination: float  # of the Earth's field after the fit: tesla, radians

    @property
    def correction(self) -> Correction:
        """The correction."""
        return Correction.from_parameters(self.numbers[:PARAMETERS])

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the twelve numbers, shape (12, 12)."""
        return self.joint[:PARAMETERS, :PARAMETERS]

    @property
    def heading_sigma(self) -> float:
        """Standard deviation of the heading on the level, radians."""
        return rms_sigma(self.heading_jacobian, self.covariance)

    @property
    def heading_jacobian(self) -> FloatArray:
        """Derivative of the heading on the level by the twelve numbers, shape (24, 12)."""
        level, down = np.cos(self.inclination), np.sin(self.inclination)
        field = self.strength * np.array([0.0, level, -down])
        return heading_jacobian(self.correction, field, 0.0)

    def distance_to(self, other: Posterior) -> float:
        """Return the RMS difference of heading on the level, radians."""
        return rms_heading_difference(
            self.correction, other.correction, self.strength, self.inclination
        )


def posterior(fit: Fit, to_sensor: FloatArray) -> Posterior:
    """Return the posterior of a fit: the twelve numbers with their covariance.

    `to_sensor` (3, 3) is `Mounting.matrix`.
    """
    return posterior_at(fit.state, fit.covariance, to_sensor)


def posterior_at(state: State, known: FloatArray, to_sensor: FloatArray) -> Posterior:
    """Return the posterior, from a state and the covariance (SHARED, SHARED) of its unknowns."""
    shared = state.shared
    up = unit(np.median(state.attitude[:, :, 2], axis=0))
    correction = correction_of(shared, to_sensor, up)
    jacobian = _by_shared(correction, shared, to_sensor, up)
    known_by = 3 if known[AT["motors_current"], AT["motors_current"]].any() else 2
    by_motors = np.zeros((3 * known_by, SHARED))
    for k, name in enumerate(MOTORS[:known_by]):
        by_motors[3 * k : 3 * k + 3, AT[name]] = to_sensor / MICROTESLA
    both = np.vstack([jacobian, by_motors])
    joint = both @ known @ both.T
    offset = known[AT["force_offset"]] @ jacobian.T
    own = np.linalg.pinv(known[AT["force_offset"], AT["force_offset"]])
    level, down = shared[EARTH] / MICROTESLA
    return Posterior(
        np.concatenate([correction.parameters, by_motors @ shared]),
        0.5 * (joint + joint.T),
        offset.T @ own @ offset,
        float(np.hypot(level, down)),
        float(np.arctan2(down, level)),
    )


def motors_of(found: Posterior, fit: Fit) -> MotorField | None:
    """Return the motors' field of a fit; None if the model had no motors.

    The current is an input only if the turn shows a field that follows the current. In a turn by
    hand, the current is that of the electronics and says nothing of the motors' field.
    """
    if not (np.diag(found.joint)[PARAMETERS:] > 0.0).all():
        return None
    course = fit.point.course
    moves = course.moving > 0.0
    rate, currents = course.nodes.rate[moves, 2], course.nodes.currents
    usual, reference = [1.0, _usual(rate)], math.nan
    if currents is not None and fit.point.groups["motors_current"] > BEYOND_USUAL:
        usual.append(_usual(currents.at(fit.state.shared[CURRENT_LATE])[moves]))
        reference = currents.battery.reference
    rows = slice(PARAMETERS, PARAMETERS + 3 * len(usual))
    motors = MotorField(
        INPUTS[: len(usual)],
        found.numbers[rows].reshape(-1, 3),
        found.joint[rows, rows],
        found.joint[:PARAMETERS, rows],
        fit.point.sizes["motors_noise"] / MICROTESLA,
        tuple(usual),
        reference,
    )
    side = float(np.mean(np.sign(rate))) if len(rate) else 0.0
    if abs(side) <= ONE_WAY:
        return motors
    motors = motors.with_twin(MotorInput.MOVING, MotorInput.SIDE, side)
    return motors.with_twin(MotorInput.TURN_RATE, MotorInput.ABS_TURN_RATE, side)


def _usual(values: FloatArray) -> float:
    """Return the root mean square; zero if there are no values."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def correction_of(shared: FloatArray, to_sensor: FloatArray, up: FloatArray) -> Correction:
    """Return the correction of the shared unknowns, SI units.

    The corrected field is in axes in which up is that of the accelerometer at rest. `to_sensor`
    (3, 3) is the rotation from nominal body axes to sensor axes; `up` (3,) is up in body axes of
    the level robot.
    """
    matrix = _to_shown(shared, up) @ np.linalg.inv(to_sensor @ distortion(shared))
    return Correction(np.asarray(matrix), to_sensor @ shared[AT["iron"]] / MICROTESLA)


def _to_shown(shared: FloatArray, up: FloatArray) -> FloatArray:
    """Return the rotation from body axes to those in which up is that of the accelerometer."""
    shown = unit(STANDARD_GRAVITY * up + shared[AT["force_offset"]])
    return np.asarray(exp_rotations(np.cross(up, shown)[None])[0])


def _by_shared(
    here: Correction, shared: FloatArray, to_sensor: FloatArray, up: FloatArray
) -> FloatArray:
    """Return the derivative of the twelve numbers by the shared unknowns, (12, SHARED)."""
    out, step = np.zeros((PARAMETERS, SHARED)), math.sqrt(np.finfo(np.float64).eps)
    for name in OF_CORRECTION:
        for k in range(AT[name].start, AT[name].stop):
            ahead = correction_of(shared + step * (np.arange(SHARED) == k), to_sensor, up)
            out[:, k] = (ahead.parameters - here.parameters) / step
    return out
