"""The samples of a report as its pictures show them: angles, headings and deviations."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.calibration.calibration import Calibration, Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.doctor.sensor_report import SensorReport, examine_window
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray, integral
from magcal_ros.core.geometry.attitude import (
    body_from_enu,
    field_in_enu,
    mean_angle,
    unit,
    wrap_angle,
    yaw_from_up_and_field,
    yaw_rate,
)
from magcal_ros.core.geometry.shapes import Circle
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.heading.compass import Compass
from magcal_ros.core.heading.motor_inputs import MotionDetector
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.coverage import Coverage, yaw_progress
from magcal_ros.core.samples.streams import ImuSample
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.gyro_swing import SWING, without_gyro_errors
from magcal_ros.core.up.follower import UpFollower, propagated_up


@dataclass(frozen=True, eq=False)
class Subject:
    """The subject of a report: one calibration or one refused attempt."""

    window: Window
    knowledge: Knowledge
    outcome: Outcome
    """The result, which may be a refusal."""
    source: str  # topics or recording of the samples; any text, because it is escaped
    method: str  # name of the requested method
    created: datetime = field(default_factory=lambda: datetime.now().astimezone())
    """Time of the calibration, by default now."""
    title: str = "Compass calibration"
    magnetometer_frame: str = ""
    imu_frame: str = ""
    """`frame_id` of field and IMU if known; any text, because it is escaped."""
    vehicle: str = ""  # the IMU's yaw in the vehicle by driving, in words; empty if unknown

    @property
    def answered_by(self) -> str:
        """Name of the method that gave the result, because a turn may be fitted as a drive."""
        estimate = self.outcome.estimate
        return self.method if estimate is None else estimate.method


MICRO = 1e6

MOST_POINTS = 400
"""Points of one series in a picture; more would only make the file larger."""


@dataclass(frozen=True, eq=False)
class CorrectedTurn:
    """The samples after the correction, one row per sample."""

    estimate: Estimate
    field: FloatArray
    """Corrected field in body axes, tesla. Shape (n, 3)."""
    circle: FloatArray
    """The estimated reference field in a full turn, body axes, tesla. Shape (m, 3)."""
    yaw: FloatArray  # magnetic ENU yaw, radians. Shape (n,).
    sigma: FloatArray  # sigma of the yaw as published by the node, radians. Shape (n,).
    reference: FloatArray  # yaw by the gyro, or the smoothed compass, radians. Shape (n,).
    radial: FloatArray
    axial: FloatArray
    """Residual perpendicular to the turn's axis and along it, tesla. Shape (n,)."""

    @property
    def deviation(self) -> FloatArray:
        """Heading after the correction minus `reference`, radians, shape (n,)."""
        return wrap_angle(self.yaw - self.reference)


@dataclass(frozen=True, eq=False)
class Turn:
    """The samples of a subject, one row per sample."""

    time: FloatArray  # seconds since the first sample. Shape (n,).
    field: FloatArray
    """Raw field after the known gains and the nominal mounting, tesla. Shape (n, 3)."""
    up: FloatArray  # specific force over its length. Shape (n, 3).
    yaw: FloatArray  # yaw of the raw field, radians. Shape (n,).
    angle: FloatArray | None
    """Radians since the first sample, left positive; None if unknown. Shape (n,)."""
    has_gyro: bool  # whether a gyro measured the angle
    inliers: BoolArray  # inliers of the fit; all without a fit. Shape (n,).
    coverage: Coverage
    corrected: CorrectedTurn | None
    sensors: SensorReport
    """The findings of `doctor` for the samples."""
    swing_bound: float | None = None
    """Limit of a good swing against the gyro, degrees rms; None if it is not graded."""

    @classmethod
    def of(cls, subject: Subject) -> Turn:
        """Compute the contents of the pictures for a subject."""
        window, estimate = subject.window, subject.outcome.estimate
        field = window.field @ subject.knowledge.mounting.to_body.T
        up = unit(window.specific_force)
        # The node uses the up vector propagated by the gyro, so the comparison does, too.
        level = up if estimate is None else propagated_up(window)
        progress = gyro = corrected = None
        rate = window.angular_rate
        if window.field.any() and window.specific_force.any():
            progress = yaw_progress(window.time, field, window.specific_force, rate)
        if rate is not None and len(window) > 1:
            gyro = integral(window.time, yaw_rate(rate, level))
        inliers = np.ones(len(window), dtype=np.bool_)
        if estimate is not None:
            inliers = np.asarray(estimate.inliers)
            corrected = _correct(subject, estimate, level, gyro)
        angle = gyro
        if angle is None and corrected is not None:
            angle = np.asarray(corrected.reference - corrected.reference[0])
        compared = (Figure.GYRO_COMPASS_SWING, Figure.GYRO_COMPASS_DIFFERENCE)
        checks = subject.outcome.verdict.checks
        bounds = (check.bound for check in checks if check.figure in compared)
        return cls(
            time=np.asarray(window.time - window.time[0]) if len(window) else window.time,
            field=np.asarray(field),
            up=up,
            yaw=yaw_from_up_and_field(level, field),
            angle=progress if angle is None else angle,
            has_gyro=gyro is not None,
            inliers=inliers,
            coverage=Coverage.nothing() if progress is None else Coverage.of(progress),
            corrected=corrected,
            sensors=examine_window(window, subject.knowledge),
            swing_bound=next((bound.good for bound in bounds if bound is not None), None),
        )

    @property
    def kind(self) -> str:
        """The kind of the samples: turn or drive."""
        found = self.corrected
        is_drive = found is not None and Figure.HEADINGS_DRIVEN in found.estimate.figures
        return "drive" if is_drive else "turn"

    def rows(self, mask: BoolArray | None = None, most: int = MOST_POINTS) -> IntArray:
        """Return at most `most` row numbers in the mask, evenly spaced."""
        rows = np.arange(len(self.time)) if mask is None else np.flatnonzero(mask)
        if len(rows) > most:
            rows = rows[np.linspace(0, len(rows) - 1, most).astype(np.int64)]
        return np.asarray(rows, dtype=np.int64)


def _correct(
    subject: Subject, estimate: Estimate, up: FloatArray, gyro: FloatArray | None
) -> CorrectedTurn:
    window = subject.window
    calibration = subject.outcome.calibration
    if calibration is None:
        calibration = Calibration.from_estimate(
            estimate, subject.outcome.verdict.evidence(estimate)
        )
    field, sigma = _published(calibration, window, up)
    yaw = yaw_from_up_and_field(up, field)
    residual = estimate.residual @ estimate.correction.matrix.T
    axial = residual @ estimate.axis
    model = field - residual
    outward = unit(model - np.outer(model @ estimate.axis, estimate.axis))
    return CorrectedTurn(
        estimate=estimate,
        field=field,
        circle=_ideal_circle(estimate, up, field),
        yaw=yaw,
        sigma=sigma,
        reference=_reference(window.time, yaw, gyro, np.asarray(estimate.inliers)),
        radial=np.einsum("ni,ni->n", residual, outward),
        axial=np.asarray(axial),
    )


def _ideal_circle(estimate: Estimate, up: FloatArray, field: FloatArray) -> FloatArray:
    """Return the estimated reference field in a full turn, body axes, shape (m, 3)."""
    inliers = estimate.inliers if estimate.inliers.any() else np.ones(len(up), dtype=np.bool_)
    attitudes = body_from_enu(up[inliers], field[inliers])
    axis_in_world = unit(np.einsum("nij,i->nj", attitudes, estimate.axis).mean(axis=0))
    along = float(field_in_enu(estimate.strength, estimate.inclination) @ axis_in_world)
    radius = math.sqrt(max(estimate.strength**2 - along**2, 0.0))
    across = np.linalg.svd(estimate.axis[None])[2][1:]
    circle = Circle(along * estimate.axis, np.vstack([across, estimate.axis]), radius)
    return circle.at(np.linspace(0.0, math.tau, 121))


def _published(
    calibration: Calibration, window: Window, up: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the field (n, 3), tesla, and the yaw's sigma (n,), radians, as in the node.

    The field of the motors is subtracted if it is known.
    """
    compass, follower, sense = Compass(calibration), UpFollower(), MotionDetector()
    rate = window.angular_rate
    rates = np.full(window.field.shape, math.nan) if rate is None else rate
    currents = np.full(len(window), math.nan)
    if window.battery is not None:
        currents = np.interp(window.time, window.battery.time, window.battery.current)
    rows = (window.time, window.field, window.specific_force, rates, up, currents)
    fields, sigmas = list[Triple](), list[float]()
    for stamp, raw, force, turn, upwards, current in zip(
        *(each.tolist() for each in rows), strict=True
    ):
        motor_state = sense.newest
        if calibration.motors is not None:
            follower.add(ImuSample(stamp, force, turn))
            follower.add_field(stamp, raw)
            turn = follower.rate if follower.is_propagated else None
            still, reference = follower.is_at_rest, calibration.motors.reference
            motor_state = sense.at(stamp, turn, still, math.nan, current, reference)
        field, motors = compass.at_rest(stamp, raw, turn, motor_state)
        heading = compass.heading(field, upwards, motors=motors)
        fields.append(field)
        sigmas.append(math.nan if heading is None else math.sqrt(heading.yaw_variance))
    return np.array(fields).reshape(-1, 3), np.array(sigmas)


def _reference(
    time: FloatArray, yaw: FloatArray, gyro: FloatArray | None, inliers: BoolArray
) -> FloatArray:
    """Return the yaw to compare with: by the gyro, or without one the smoothed compass."""
    if not inliers.any():
        inliers = np.ones(len(yaw), dtype=np.bool_)
    if gyro is None:
        return _smooth_course(time, yaw, inliers)
    error = wrap_angle(yaw - gyro - mean_angle((yaw - gyro)[inliers]))
    alike = len(time) * SWING.sector / (float(np.ptp(gyro)) + SWING.sector)
    return np.asarray(yaw - without_gyro_errors(error, time, gyro, alike))


def _smooth_course(time: FloatArray, yaw: FloatArray, inliers: BoolArray) -> FloatArray:
    """Return the unwrapped yaw, smoothed by local lines over a twentieth of the samples."""
    # Imported here, because the import is slow and only needed without a gyro.
    from scipy.signal import savgol_filter

    course = np.interp(time, time[inliers], np.unwrap(yaw[inliers]))
    width = 2 * max(2, len(time) // 40) + 1
    return course if len(time) < width else np.asarray(savgol_filter(course, width, 1))
