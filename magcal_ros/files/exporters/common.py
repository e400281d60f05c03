"""What exporters share: units, frames, numbers, and what a symmetric matrix loses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.errors import MagcalError
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import FRD_FROM_FLU
from magcal_ros.core.geometry.rotations import rotation_angle, rpy_from_rotation
from magcal_ros.files.plain import plain

GAUSS = 1e4
"""Gauss in a tesla."""

MILLIGAUSS = 1e7
"""Milligauss in a tesla."""

DECIMALS = 9
"""Of a matrix or of gauss. What is cut off changes no field by more than 0.001 nT."""

OF_TESLA = 13
"""The same of tesla."""

LARGEST_LOST_ROTATION = math.radians(5.0)
"""A rotation beyond this belongs into the consumer's mounting, not into a comment."""

MENTIONED_ROTATION = math.radians(0.5)


class NotExportable(MagcalError):
    """The consumer cannot hold this calibration; the text says what to do."""


@dataclass(frozen=True, eq=False)
class Symmetric:
    """A correction without its rotation, in forward-right-down axes."""

    matrix: FloatArray
    """Symmetric. Shape (3, 3)."""
    hard_iron: FloatArray
    """Tesla. Shape (3,)."""
    comments: tuple[str, ...]
    """What was lost."""


def in_forward_right_down(correction: Correction) -> Correction:
    """Return a correction of forward-left-up fields for fields given forward-right-down."""
    return Correction(
        FRD_FROM_FLU @ correction.matrix @ FRD_FROM_FLU, FRD_FROM_FLU @ correction.hard_iron
    )


def without_rotation(correction: Correction, consumer: str) -> Symmetric:
    """Split off the rotation R of A = R S and keep the symmetric S.

    Parameters
    ----------
    correction : Correction
        In forward-left-up axes.
    consumer : str
        Its name, for the comments.

    Raises
    ------
    NotExportable
        If the rotation is more than 5°: the consumer's heading would be wrong.
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
            f"{shown}°, more than {largest:g}° ({turned}). Tell the nominal mounting to {consumer} "
            "as its sensor rotation, let the driver publish in the mounted axes, and calibrate "
            "again."
        )
    comments: tuple[str, ...] = ()
    if angle > MENTIONED_ROTATION:
        comments = (
            f"LOST: a rotation of {math.degrees(angle):.2f} degrees, {turned}.",
            f"{consumer} holds a symmetric matrix only; the heading errs by up to that rotation,",
            "times the tangent of the field's inclination where it is about a level axis.",
        )
    framed = in_forward_right_down(Correction(symmetric, correction.hard_iron))
    return Symmetric(framed.matrix, framed.hard_iron, comments)


def _above(value: float, limit: float) -> str:
    """Write a value with as many digits as show that it is above the limit."""
    digits = next(n for n in range(1, 16) if float(f"{value:.{n}f}") > limit or n == 15)
    return f"{value:.{digits}f}"


def number(value: float, decimals: int = DECIMALS) -> str:
    """Write a number without the digits that are rounding errors, as a float everywhere."""
    text = repr(round(float(value), decimals) + 0.0)
    # YAML 1.1 takes 1e-05 for text: it wants a point in the mantissa.
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa}.0e{exponent}" if mark and "." not in mantissa else text


def numbers(values: FloatArray, decimals: int = DECIMALS) -> str:
    """Write numbers separated by a comma and a blank."""
    return ", ".join(number(value, decimals) for value in np.ravel(values))


def commented(mark: str, *lines: str) -> str:
    """Return lines as comments."""
    return "".join(f"{mark} {line}\n" for line in lines)


def provenance(calibration: Calibration) -> str:
    """Return where the numbers come from, in one line."""
    evidence = calibration.evidence
    method, quality, confidence = (
        # A file edited by hand must not end the comment that this becomes.
        plain(text.replace("*/", "* /"))
        for text in (evidence.method, evidence.quality, evidence.confidence)
    )
    return (
        f"Magnetometer calibration by magcal_ros, method {method}, "
        f"quality {quality}, confidence {confidence}"
    )
