"""A calibration in the formats of other programs, one function for each.

Each returns the text that the other program reads. A comment describes any part that this program
cannot store. An export that would make its heading wrong is refused.
"""

from __future__ import annotations

import functools
import math
import operator
import re
from collections.abc import Callable

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.errors import MagcalError
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import FRD_FROM_FLU
from magcal_ros.core.geometry.rotations import rotation_angle, rpy_from_rotation
from magcal_ros.files.disk import printable
from magcal_ros.files.px4 import mounting_of

GAUSS = 1e4  # gauss in a tesla
MILLIGAUSS = 1e7  # milligauss in a tesla
DECIMALS = 9  # of a matrix or of gauss: rounding changes no field by more than 0.001 nT.

OF_TESLA = 13

LARGEST_LOST_ROTATION = math.radians(5.0)
"""Largest rotation that may be left out; a larger one must be set in the consumer as mounting."""

MENTIONED_ROTATION = math.radians(0.5)


class NotExportable(MagcalError):
    """The other program cannot hold this calibration; the text has a remedy."""


def in_forward_right_down(correction: Correction) -> Correction:
    """Return a correction of forward-left-up fields for fields given forward-right-down."""
    return Correction(
        FRD_FROM_FLU @ correction.matrix @ FRD_FROM_FLU, FRD_FROM_FLU @ correction.hard_iron
    )


def without_rotation(correction: Correction, consumer: str) -> tuple[Correction, list[str]]:
    """Split the rotation R off A = R S; return S, symmetric and forward-right-down, and comments.

    `consumer` is named in the comments. NotExportable if the rotation is more than 5°: the
    consumer's heading would be wrong.
    """
    left, sizes, right = np.linalg.svd(correction.matrix)
    rotation, symmetric = left @ right, (right.T * sizes) @ right
    angle = rotation_angle(rotation)
    roll, pitch, yaw = (round(math.degrees(v), 2) + 0.0 for v in rpy_from_rotation(rotation))
    turned = f"roll {roll:.2f}, pitch {pitch:.2f}, yaw {yaw:.2f} degrees (forward-left-up)"
    largest = math.degrees(LARGEST_LOST_ROTATION)
    if angle > LARGEST_LOST_ROTATION:
        shown = _above(math.degrees(angle), largest)
        raise NotExportable(
            f"{consumer} holds a symmetric matrix only, and this calibration turns the field by "
            f"{shown}°, more than {largest:g}° ({turned}). Mount the sensor along the axes of "
            f"{consumer}, or set this rotation there as the sensor's orientation (as a custom one, "
            "if the list has none like it); then record and fit again."
        )
    comments = [
        f"LOST: a rotation of {math.degrees(angle):.2f} degrees, {turned}.",
        f"{consumer} holds a symmetric matrix only; the heading error is up to that rotation,",
        "times the tangent of the field's inclination where it is about a level axis.",
    ]
    held = in_forward_right_down(Correction(symmetric, correction.hard_iron))
    return held, comments if angle > MENTIONED_ROTATION else []


def _above(value: float, limit: float) -> str:
    """Write a value with enough digits to be above the limit."""
    digits = next(n for n in range(1, 16) if float(f"{value:.{n}f}") > limit or n == 15)
    return f"{value:.{digits}f}"


def number(value: float, decimals: int = DECIMALS) -> str:
    """Write a number, rounded, in a form that every consumer reads as a float."""
    text = repr(round(float(value), decimals) + 0.0)
    # YAML 1.1 reads 1e-05 as text, and needs a point in the mantissa.
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa}.0e{exponent}" if mark and "." not in mantissa else text


def numbers(values: FloatArray, decimals: int = DECIMALS) -> str:
    """Write numbers separated by a comma and a blank."""
    return ", ".join(number(value, decimals) for value in np.ravel(values))


def provenance(calibration: Calibration) -> str:
    """Return the origin of the numbers in one line."""
    evidence = calibration.evidence
    texts = evidence.method, evidence.quality, evidence.confidence
    # Texts of a file edited by hand must not end the comment that they become part of.
    return "Magnetometer calibration by magcal_ros, method {}, quality {}, confidence {}".format(
        *(printable(text.replace("*/", "* /")) for text in texts)
    )


def commented(calibration: Calibration, *comments: str) -> str:
    """Return the origin of the numbers and more lines, as comments."""
    return "".join(f"# {line}\n" for line in (provenance(calibration), *comments))


def parameter_file(*entries: str) -> str:
    """Return a parameter file for nodes of every name."""
    return "\n".join(["/**:", "  ros__parameters:", *(f"    {each}" for each in entries), ""])


def hard_iron_entries(calibration: Calibration, prefix: str) -> list[str]:
    """Return the hard iron, tesla, as three parameters that begin with `prefix`."""
    iron = zip("xyz", calibration.correction.hard_iron, strict=True)
    return [f"{prefix}_{axis}: {number(value, OF_TESLA)}" for axis, value in iron]


def autopilot_entries(
    form: str, names: tuple[str, str, str], offsets: FloatArray, matrix: FloatArray
) -> str:
    """Return a line for each number of offsets (3,) and a symmetric matrix (3, 3), by `form`."""
    values = offsets, matrix.diagonal(), matrix[np.triu_indices(3, 1)]
    return "".join(
        form.format(name, axis, number(value)) + "\n"
        for name, three in zip(names, values, strict=True)
        for axis, value in zip("XYZ", three, strict=True)
    )


def ctu_vras(calibration: Calibration) -> str:
    """Return a parameter file for the compass stack of ctu-vras, for nodes of every name.

    `unbiased = M (mag - bias)`, tesla, M row by row
    (docs.ros.org/en/jazzy/p/magnetometer_pipeline). The documentation names the matrix
    `initial_scaling_matrix`; the node reads `initial_mag_scaling_matrix`. Both are written: a node
    ignores parameters that it does not declare. magnetometer_bias_observer loads
    `magnetometer_bias_x/y/z` under `load_from_params`, and publishes this bias without a matrix. A
    matrix that the receiver got as a parameter stays in force.
    """
    matrix = f"[{numbers(calibration.correction.matrix)}]"
    formula = "unbiased = scaling_matrix * (mag - bias): tesla; the result is in the IMU's axes."
    return commented(calibration, formula) + parameter_file(
        *hard_iron_entries(calibration, "initial_mag_bias"),
        *hard_iron_entries(calibration, "magnetometer_bias"),
        f"initial_mag_scaling_matrix: {matrix}",
        f"initial_scaling_matrix: {matrix}",
    )


def fusioncore(calibration: Calibration) -> str:
    """Return a parameter file for FusionCore; field_strength is that of the corrected field.

    FusionCore uses the calibrator's yaw. Its own compass is disabled, but has the calibration, too.

    `corrected = soft_iron (mag - hard_iron)`, tesla, soft iron as a "3x3 scale+rotation matrix in
    row-major order" (docs/configuration.md of github.com/manankharwar/fusioncore).
    """
    correction, tesla = calibration.correction, OF_TESLA
    header = commented(
        calibration,
        "FusionCore takes the yaw of the node calibrator, which has to run. To use its own compass",
        "instead, set magnetometer.enabled to true and remove gnss.heading_topic. CAUTION: its",
        "compass gives every heading a sigma of 0.05 rad (magnetometer.noise_rad), and needs MINUS",
        "the declination as magnetometer.declination_rad.",
        "corrected = soft_iron * (mag - hard_iron): tesla, for the readings as the driver",
        "publishes them. soft_iron turns them into the IMU's axes: they must not be turned twice.",
    )
    return header + parameter_file(
        "gnss.heading_topic: compass/true/enu/imu",
        "magnetometer.enabled: false",
        f"magnetometer.hard_iron: [{numbers(correction.hard_iron, tesla)}]",
        f"magnetometer.soft_iron: [{numbers(correction.matrix)}]",
        f"magnetometer.field_strength: {number(calibration.strength, tesla)}",
    )


UNCHANGED = 1e-9


def imu_filter_madgwick(calibration: Calibration) -> str:
    """Return a parameter file for imu_filter_madgwick, which corrects the hard iron only.

    `compensated = mag - mag_bias`, tesla (wiki.ros.org/imu_filter_madgwick).
    """
    comments = ["compensated = mag - mag_bias, tesla."]
    matrix = calibration.correction.matrix
    if np.abs(matrix - np.eye(3)).max() > UNCHANGED:
        left, sizes, right = np.linalg.svd(matrix)
        angle = math.degrees(rotation_angle(left @ right))
        comments += [
            f"LOST: installation of {angle:.2f} degrees and soft iron with gains from "
            f"{sizes.min():.4f} to {sizes.max():.4f}; this filter corrects the hard iron only.",
            "To lose nothing, let it subscribe to imu/mag_unbiased of the calibrator, with zeros "
            "here.",
        ]
    entries = hard_iron_entries(calibration, "mag_bias")
    return commented(calibration, *comments) + parameter_file(*entries)


LARGEST_NUMBER = 1e3


def vectornav(calibration: Calibration) -> str:
    """Return the command that writes register 23, in one line; `$VNWNV` stores it for good.

    `X = C (M - B)`, C row by row, B in gauss, forward-right-down axes (VN-100 user manual UM001,
    6.2.1). The checksum is the exclusive or of the bytes between `$` and `*`. A command has no
    comments, so its assumptions are in `NOTES`. NotExportable if a number is too large for the
    fixed-point notation.
    """
    held = in_forward_right_down(calibration.correction)
    twelve = np.concatenate([held.matrix.ravel(), GAUSS * held.hard_iron])
    if np.abs(twelve).max() >= LARGEST_NUMBER:
        raise NotExportable(
            "The calibration has numbers that no VectorNav sensor could need. Check the field's "
            "unit (tesla) in the driver, and calibrate again."
        )
    written = (f"{round(value, DECIMALS) + 0.0:.{DECIMALS}f}" for value in twelve)
    body = f"VNWRG,23,{','.join(written)}"
    return f"${body}*{checksum(body):02X}\n"


def checksum(body: str) -> int:
    """Return the exclusive or of a command's bytes, without `$` and `*`."""
    return functools.reduce(operator.xor, body.encode("ascii"), 0)


def c_header(calibration: Calibration) -> str:
    """Return a header with an include guard that any C or C++ compiler accepts."""
    correction = calibration.correction
    iron = numbers(correction.hard_iron, OF_TESLA)
    rows = ",\n".join(f"    {{{numbers(row)}}}" for row in correction.matrix)
    return (
        f"/* {provenance(calibration)}.\n"
        " * body = MAGCAL_MATRIX * (raw - MAGCAL_HARD_IRON): tesla, in the IMU's axes\n"
        " * (x forward, y left, z up). */\n"
        "#ifndef MAGCAL_CALIBRATION_H\n"
        "#define MAGCAL_CALIBRATION_H\n\n"
        f"static const double MAGCAL_HARD_IRON[3] = {{{iron}}};\n"
        f"static const double MAGCAL_MATRIX[3][3] = {{\n{rows}}};\n\n"
        "#endif\n"
    )


ARDUPILOT_FRAME = "ardupilot_compass"
"""Prefix of the magnetometer's frame in a calibration from a log of ArduPilot."""


def ardupilot(calibration: Calibration, frame: str = "") -> str:
    """Return a parameter file for a ground station, `NAME,value` lines.

    ArduPilot: offsets that are added, and a symmetric matrix.

    `corrected = D (mag + OFS)` with D = [[DIA_X, ODI_X, ODI_Y], [ODI_X, DIA_Y, ODI_Z],
    [ODI_Y, ODI_Z, DIA_Z]], milligauss, forward-right-down body axes after COMPASS_ORIENT. The full
    parameter list says of COMPASS_OFS_X "Offset to be added to the compass x-axis values": the sign
    is the opposite of the hard iron's. COMPASS_SCALE is a further factor, and must be 1.

    The calibration is of fields in the vehicle's forward-left-up axes. `frame` is the
    magnetometer's; if it is from a log, it gives the number of the compass. NotExportable if the
    field is turned by more than 5°.
    """
    held, comments = without_rotation(calibration.correction, "ArduPilot")
    of_log = re.fullmatch(rf"{ARDUPILOT_FRAME}([23]?)", frame)
    slot = of_log[1] if of_log else ""
    origin = (
        f"From a log, whose own OFS, DIA, ODI and SCALE were removed: compass {slot or 1}.",
        "These numbers replace those in force; COMPASS_MOT and COMPASS_ORIENT stay. Where DIA or",
        "SCALE change by more than a few percent, run CompassMot again: it is added after them.",
    )
    driver = (
        "DEPENDS ON readings without COMPASS_OFS in them. MAVLink's RAW_IMU, and so imu/mag of",
        "MAVROS, includes them: calibrate with OFS and ODI at 0, DIA and SCALE at 1, or add these",
        "OFS to those in force.",
    )
    header = commented(
        calibration,
        "corrected = D * (mag + OFS), milligauss, forward-right-down. Offsets beyond 1800 need",
        "a larger COMPASS_OFFS_MAX.",
        *(origin if of_log else driver),
        *comments,
    )
    form, offsets = f"COMPASS_{{}}{slot}_{{}},{{}}", -MILLIGAUSS * held.hard_iron
    lines = autopilot_entries(form, ("OFS", "DIA", "ODI"), offsets, held.matrix)
    return f"{header}{lines}COMPASS_SCALE{slot},1.0\n"


SMALLEST_SCALE, LARGEST_SCALE = 0.1, 3.0


def px4(calibration: Calibration, frame: str = "") -> str:
    """Return commands for the PX4 console, `param set NAME value` lines.

    PX4: offsets that are subtracted, and a symmetric matrix.

    `corrected = R S (mag - OFF)` with S = [[XSCALE, XODIAG, YODIAG], [XODIAG, YSCALE, ZODIAG],
    [YODIAG, ZODIAG, ZSCALE]], gauss, in the sensor's own forward-right-down axes. R is
    CAL_MAG0_ROT, one of a few rotations, and is not changed (parameter reference, CAL_MAG0_XOFF in
    gauss, CAL_MAG0_XSCALE, CAL_MAG0_XODIAG). Scales must lie between 0.1 and 3.

    The calibration is of fields in the vehicle's forward-left-up axes. `frame` is the
    magnetometer's; if it is from a log, it gives the slot and the rotation. NotExportable if the
    field is turned by more than 5°, or scaled beyond PX4's range.
    """
    held, comments = without_rotation(calibration.correction, "PX4")
    of_log = mounting_of(frame)
    slot, turn, name = of_log or (0, np.eye(3), "")  # the parameters are in the sensor's own axes
    matrix, offset = turn.T @ held.matrix @ turn, turn.T @ held.hard_iron
    scales = matrix.diagonal()
    if scales.min() < SMALLEST_SCALE or scales.max() > LARGEST_SCALE:
        raise NotExportable(
            f"PX4 takes scales from {SMALLEST_SCALE} to {LARGEST_SCALE} only, and this calibration "
            f"has {scales.min():.3g} to {scales.max():.3g}. Check the field's unit (tesla) in the "
            "driver, and calibrate again."
        )
    origin = (
        f"From a log, whose own calibration was removed: CAL_MAG{slot}, mounted as {name}.",
        "These numbers replace those in force; the compensation for the power stays.",
    )
    driver = (
        "For the first magnetometer and CAL_MAG0_ROT = 0 or -1.",
        "DEPENDS ON CAL_MAG0_ID being the device that was calibrated: PX4 finds a sensor's numbers",
        "by it (param show CAL_MAG*_ID); if another slot has it, put that number for the 0.",
    )
    header = commented(
        calibration,
        "corrected = ROT * S * (mag - OFF), gauss, forward-right-down.",
        *(origin if of_log else driver),
        *comments,
    )
    form = f"param set CAL_MAG{slot}_{{1}}{{0}} {{2}}"
    return header + autopilot_entries(form, ("OFF", "SCALE", "ODIAG"), GAUSS * offset, matrix)


EXPORTERS: dict[str, Callable[..., str]] = {
    "ctu-vras": ctu_vras,
    "imu_filter_madgwick": imu_filter_madgwick,
    "fusioncore": fusioncore,
    "ardupilot": ardupilot,
    "px4": px4,
    "vectornav": vectornav,
    "c-header": c_header,
}
"""By the name of the format; each takes the calibration."""

OF_LOGS = {"ardupilot", "px4"}
"""Formats that also take the magnetometer's frame, which identifies the sensor of a log."""

NOTES = {
    "vectornav": "register 23 had to be the identity while the turn was made, and the field in the "
    "sensor's own axes: ROS drivers publish the compensated field, some in axes of their own"
}
"""Assumptions of the formats without comments, by the name of the format."""
