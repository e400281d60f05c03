"""The samples of a report as its pictures show them: angles, headings and deviations."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
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
from magcal_ros.core.heading.compass import Compass, CompassReader, CompassReading
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.battery import newest_at
from magcal_ros.core.samples.coverage import Coverage, yaw_progress
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.gyro_swing import SWING, without_gyro_errors
from magcal_ros.core.up.follower import Up, UpFollower, propagated_up


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
    sigma: FloatArray  # sigma of the yaw as a node publishes it after a rest, radians. Shape (n,).
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
        window, outcome = subject.window, subject.outcome
        estimate, calibration = outcome.estimate, outcome.calibration
        if estimate is not None and calibration is None:
            calibration = Calibration.from_estimate(estimate, outcome.verdict.evidence(estimate))
        field = window.field @ subject.knowledge.mounting.to_body.T
        up = unit(window.specific_force)
        # The node uses the up vector propagated by the gyro, so the comparison does, too.
        level = up if estimate is None else propagated_up(window)
        progress = gyro = corrected = None
        rate = window.angular_rate
        if window.field.any() and window.specific_force.any():
            progress = yaw_progress(window.time, field, window.specific_force, rate)
        if rate is not None and len(window) > 1:
            scale = calibration.evidence.figure(Figure.GYRO_SCALE, 0.0) if calibration else 0.0
            gyro = (1.0 - scale) * integral(window.time, yaw_rate(rate, level))
        inliers = np.ones(len(window), dtype=np.bool_)
        if estimate is not None and calibration is not None:
            inliers = np.asarray(estimate.inliers)
            readings = list(_readings(calibration, window, level))
            corrected = _correct(window.time, estimate, readings, level, gyro)
        angle = gyro
        if angle is None and corrected is not None:
            angle = np.asarray(corrected.reference - corrected.reference[0])
        compared = (Figure.GYRO_COMPASS_SWING, Figure.GYRO_COMPASS_DIFFERENCE)
        checks = outcome.verdict.checks
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
    time: FloatArray,
    estimate: Estimate,
    readings: Sequence[CompassReading],
    up: FloatArray,
    gyro: FloatArray | None,
) -> CorrectedTurn:
    field = np.array([each.field for each in readings]).reshape(-1, 3)
    headings = (each.heading for each in readings)
    sigma = [math.sqrt(each.yaw_variance) if each else math.nan for each in headings]
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
        sigma=np.array(sigma),
        reference=_reference(time, yaw, gyro, np.asarray(estimate.inliers)),
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


def _readings(calibration: Calibration, window: Window, up: FloatArray) -> Iterator[CompassReading]:
    """Yield the samples as the node reads them, if it has run before: with `up` (n, 3)."""
    compass, follower, battery = Compass(calibration), UpFollower(), window.battery
    unknown = np.full(window.field.shape, math.nan)
    rates = unknown if window.angular_rate is None else window.angular_rate
    speeds = [] if window.speed is None else [*zip(window.time, window.speed, strict=True)]
    currents = [] if battery is None else [*zip(battery.time, battery.current, strict=True)]
    reader = CompassReader(
        follower, lambda stamp: (newest_at(speeds, stamp), newest_at(currents, stamp))
    )
    rows = (window.time, window.field, window.specific_force, rates, up)
    for stamp, raw, force, rate, settled in zip(*(n.tolist() for n in rows), strict=True):
        follower.add(ImuSample(stamp, force, rate))
        follower.add_field(stamp, raw)
        known = Up(settled, calibration.noise_up**2)
        yield reader.read(compass, FieldSample(stamp, raw), up=known)


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
