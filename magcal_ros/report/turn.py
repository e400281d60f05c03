"""A subject's samples in the form that pictures and tables show: angles, headings, deviations."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.calibration.calibration import Calibration, Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.doctor.page import Page, examine_window
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
from magcal_ros.core.heading.motion_sense import MotionSense
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.coverage import Coverage, yaw_progress
from magcal_ros.core.samples.streams import ImuSample
from magcal_ros.core.samples.window import Window
from magcal_ros.core.up.follower import UpFollower, propagated_up


@dataclass(frozen=True, eq=False)
class Subject:
    """One calibration, or one attempt, that a report is about."""

    window: Window
    knowledge: Knowledge
    outcome: Outcome
    """What came of it; a refusal is reported too."""
    source: str  # where the samples came from: topics, or a recording. Any text: it is escaped.
    method: str  # name of the method that was asked for
    created: datetime = field(default_factory=lambda: datetime.now().astimezone())
    """When the calibration was made; this moment unless given."""
    title: str = "Compass calibration"
    magnetometer_frame: str = ""
    imu_frame: str = ""
    """`frame_id` of field and IMU where they are known. Any text: it is escaped."""
    vehicle: str = ""  # how the IMU sits in the vehicle, where driving has shown it

    @property
    def answered_by(self) -> str:
        """Name of the method that gave the result: a turn may have been fitted as a drive."""
        estimate = self.outcome.estimate
        return self.method if estimate is None else estimate.method


MICRO = 1e6

MOST_POINTS = 400
"""Points of one series in a picture: more cannot be distinguished and make the file larger."""

GYRO_BIAS_SIGMA = math.radians(0.5)
GYRO_SCALE_SIGMA = 0.02
"""How far, rad/s and relative, a gyro may be off without the compass being blamed."""

COMPASS_SIGMA = math.radians(2.0)
INDEPENDENT_SAMPLES = 20
"""Neighbours err together; so many of them are taken to count in a comparison with the gyro."""


@dataclass(frozen=True, eq=False)
class Corrected:
    """What the estimate makes of the samples, one row per sample."""

    estimate: Estimate
    field: FloatArray
    """Corrected field in body axes, tesla. Shape (n, 3)."""
    circle: FloatArray
    """The field that was found, turned once about the axis, body axes, tesla. Shape (m, 3)."""
    yaw: FloatArray  # magnetic ENU yaw, radians. Shape (n,).
    sigma: FloatArray  # its standard deviation as the node would publish it, radians. Shape (n,).
    reference: FloatArray  # the yaw that the turn asks for, radians. Shape (n,).
    radial: FloatArray
    axial: FloatArray
    """Residual away from the turn's axis and along it, tesla. Shape (n,)."""

    @property
    def deviation(self) -> FloatArray:
        """Heading after the correction minus what the turn asks for, radians, shape (n,)."""
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
    """Radians since the first sample, left positive; None if nothing shows it. Shape (n,)."""
    has_gyro: bool  # whether a gyro measured the angle
    inliers: BoolArray  # inliers of the fit; all where there was none. Shape (n,).
    coverage: Coverage
    corrected: Corrected | None
    sensors: Page
    """What the samples show of the sensors themselves."""
    swing_bound: float | None = None
    """Degrees rms up to which the swing against the gyro is called good; None if not judged."""

    @classmethod
    def of(cls, subject: Subject) -> Turn:
        """Work out what there is to show of a subject."""
        window, estimate = subject.window, subject.outcome.estimate
        field = window.field @ subject.knowledge.mounting.to_body.T
        up = unit(window.specific_force)
        # The heading is published with the up that the gyro propagates, so it is judged by that.
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
        """What the samples are of: a turn or a drive."""
        found = self.corrected
        is_drive = found is not None and Figure.HEADINGS_DRIVEN in found.estimate.figures
        return "drive" if is_drive else "turn"

    def rows(self, mask: BoolArray | None = None, most: int = MOST_POINTS) -> IntArray:
        """Return evenly spread row numbers, at most `most` of those in the mask."""
        rows = np.arange(len(self.time)) if mask is None else np.flatnonzero(mask)
        if len(rows) > most:
            rows = rows[np.linspace(0, len(rows) - 1, most).astype(np.int64)]
        return np.asarray(rows, dtype=np.int64)


def _correct(
    subject: Subject, estimate: Estimate, up: FloatArray, gyro: FloatArray | None
) -> Corrected:
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
    return Corrected(
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
    """Return the field that was found, turned once about the axis, body axes, shape (m, 3)."""
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
    """Return the field (n, 3), tesla, and the yaw's sigma (n,), radians, as the node makes them.

    The field of the motors, where it is known, is subtracted.
    """
    compass, follower, sense = Compass(calibration), UpFollower(), MotionSense()
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
        running = sense.newest
        if calibration.motors is not None:
            follower.add(ImuSample(stamp, force, turn))
            follower.add_field(stamp, raw)
            turn = follower.rate if follower.is_propagated else None
            still, reference = follower.is_at_rest, calibration.motors.reference
            running = sense.at(stamp, turn, still, math.nan, current, reference)
        field, motors = compass.at_rest(stamp, raw, turn, running)
        heading = compass.heading(field, upwards, motors=motors)
        fields.append(field)
        sigmas.append(math.nan if heading is None else math.sqrt(heading.yaw_variance))
    return np.array(fields).reshape(-1, 3), np.array(sigmas)


def _reference(
    time: FloatArray, yaw: FloatArray, gyro: FloatArray | None, inliers: BoolArray
) -> FloatArray:
    """Return the yaw that the turn asks for: the gyro's, or the compass's own smoothed course."""
    if not inliers.any():
        inliers = np.ones(len(yaw), dtype=np.bool_)
    if gyro is None:
        return _smooth_course(time, yaw, inliers)
    start = mean_angle((yaw - gyro)[inliers])
    error = wrap_angle(yaw - gyro - start)
    columns = np.column_stack([np.ones_like(time), gyro - gyro.mean(), time - time.mean()])
    weight = INDEPENDENT_SAMPLES / (max(int(inliers.sum()), 1) * COMPASS_SIGMA**2)
    weights = weight * inliers
    prior = np.diag([0.0, GYRO_SCALE_SIGMA**-2, GYRO_BIAS_SIGMA**-2])
    normal = columns.T @ (weights[:, None] * columns) + prior
    return np.asarray(
        gyro + start + columns @ np.linalg.solve(normal, columns.T @ (weights * error))
    )


def _smooth_course(time: FloatArray, yaw: FloatArray, inliers: BoolArray) -> FloatArray:
    """Return the unwrapped yaw through a local straight line over a twentieth of the samples."""
    # Slow to load, and of use without a gyro alone.
    from scipy.signal import savgol_filter

    course = np.interp(time, time[inliers], np.unwrap(yaw[inliers]))
    width = 2 * max(2, len(time) // 40) + 1
    return course if len(time) < width else np.asarray(savgol_filter(course, width, 1))
