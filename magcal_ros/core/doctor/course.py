"""The yaw of the magnetometer's axes by the course, which a turn on the spot cannot show."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration, Evidence
from magcal_ros.core.calibration.correction import PARAMETERS, Correction
from magcal_ros.core.doctor.alignment import FIELD, IRON, SOFT
from magcal_ros.core.doctor.axes_diagnosis import mount_of, parameter_line
from magcal_ros.core.doctor.axes_hypotheses import AxesHypothesis
from magcal_ros.core.doctor.doctor_tuning import ERRORS
from magcal_ros.core.doctor.health import Finding, ok_or_warning, severe_finding, undetermined
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import axes_in_words, is_mirrored, rotation_from_rpy
from magcal_ros.core.knowledge import Belief, Knowledge

NAME = "axes: yaw by course"
LONGER = "drive farther: straight, in several directions, and faster than walking pace"


@dataclass(frozen=True, eq=False)
class AxesInUse:
    """The magnetometer's axes by the chosen hypothesis, and a compass with these axes."""

    axes: FloatArray  # rows in body axes, after the known mounting. Shape (3, 3).
    pose: FloatArray  # the known mounting. Shape (3, 3).
    compass: Calibration  # good enough to be compared with a course


def axes_in_use(hypothesis: AxesHypothesis, knowledge: Knowledge) -> AxesInUse | None:
    """Return axes and compass of a hypothesis in rad/s and body axes; None without a compass."""
    state, size = hypothesis.state, hypothesis.part.size
    if not np.array_equal(hypothesis.gyro, np.eye(3)) or is_mirrored(hypothesis.field):
        return None
    level = float(np.linalg.norm(np.cross(state[FIELD], hypothesis.part.up[0])))
    if not float(hypothesis.sigma[IRON].max()) < ERRORS.iron * level:
        return None
    to_axes = hypothesis.field.T @ knowledge.mounting.to_body
    soft = np.eye(3) + state[SOFT].reshape(3, 3)
    hard_iron = np.asarray(np.linalg.solve(to_axes, size * state[IRON]), dtype=np.float64)
    compass = Calibration(
        Correction(np.linalg.inv(soft) @ to_axes, hard_iron),
        1e-4 * np.eye(PARAMETERS),
        1e-6,
        math.radians(1.0),
        size * float(np.linalg.norm(state[FIELD])),
        0.0,
        Evidence("doctor", "", "", ""),
    )
    return AxesInUse(hypothesis.field, knowledge.mounting.pose, compass)


def course_findings(
    used: AxesInUse, gap: Belief, imu_yaw: Belief
) -> tuple[list[Finding], tuple[int, int, int] | None]:
    """Return the findings, and the mounting that corrects a wrong yaw.

    `gap` is the yaw of the compass in `used` minus course and declination, and minus the IMU's yaw
    if known. `imu_yaw` is the IMU's yaw in the vehicle, positive to the left, from the vehicle's
    acceleration. Both are in radians.
    """
    lines = []
    knows_imu = imu_yaw.sigma < ERRORS.vague_yaw
    if knows_imu:
        lines.append(_imu_yaw(imu_yaw))
    if not gap.sigma < ERRORS.vague_yaw:
        return [*lines, undetermined("field_yaw", NAME, LONGER)], None
    quarters = round(gap.value / (0.5 * math.pi))
    evidence = (
        f"the compass is {math.degrees(gap.value):+.0f} ± {math.degrees(gap.sigma):.0f}° off the "
        "course"
    )
    if not quarters % 4 or abs(gap.value - 0.5 * math.pi * quarters) > ERRORS.near:
        return [*lines, ok_or_warning("field_yaw", NAME, evidence)], None
    axes = np.rint(used.axes @ rotation_from_rpy(0.0, 0.0, -0.5 * math.pi * quarters))
    mount = mount_of(axes, used.pose)
    turned = f"the magnetometer's axes are {axes_in_words(axes)}: set `{parameter_line(mount)}`"
    if knows_imu:
        return [*lines, severe_finding("field_yaw", NAME, evidence, turned)], mount
    either = (
        f"either {turned}; or IMU and magnetometer are both turned by {90 * quarters:+d}° to the "
        f"left of the front: set `vehicle_yaw_deg: {90.0 * quarters}`. To tell which, record the "
        "speed too, and accelerate and brake"
    )
    return [*lines, severe_finding("field_yaw", NAME, evidence, either)], None


def _imu_yaw(measured: Belief) -> Finding:
    degrees = math.degrees(measured.value)
    evidence = (
        f"x points {abs(degrees):.0f} ± {math.degrees(measured.sigma):.0f}° to the "
        f"{'left' if degrees >= 0.0 else 'right'} of the front"
    )
    remedy = (
        f"turn the IMU's axes in the driver or its joint in the URDF by {degrees:.0f}° about z, or "
        f"set `vehicle_yaw_deg: {degrees:.0f}.0`"
    )
    is_off = abs(measured.value) > ERRORS.near
    return ok_or_warning("imu_yaw", "IMU: yaw in the vehicle", evidence, remedy * is_off)
