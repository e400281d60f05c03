"""Checks that refuse unusable windows, and turns that do not determine a calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, integral
from magcal_ros.core.geometry.attitude import unit, usual_size
from magcal_ros.core.geometry.shapes import plane_normal
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.spikes import without_spikes
from magcal_ros.core.samples.window import Window

WEAKEST_FORCE = 0.8
"""m/s². Gravity in any likely unit is larger; the smallest is 1 g published as m/s²."""

NO_UNIT_EXPLAINS = {"magnetometer": 1e7, "accelerometer": 1e7, "gyro": 1e6}
"""Tesla, m/s², rad/s. The Earth's field, gravity and every turn are far below, even in nanotesla,
micro-g and millidegrees published as these."""


def refuse_empty(window: Window, min_samples: int = 20) -> None:
    """Raise `Refusal` for a window that no method can use.

    The reasons are stamps that are no times, impossible numbers, too few samples, and missing
    gravity or field.
    """
    longest = float(np.diff(window.time).max(initial=0.0))
    if longest > STREAMS.longest_pause:
        raise Refusal(
            Reason.NOT_FINITE,
            f"Two successive stamps are {longest:.3g} s apart: they must be seconds, of a clock "
            "that is not set in between.",
        )
    # The fourth powers of very large numbers overflow.
    rate = np.zeros(3) if window.angular_rate is None else window.angular_rate
    readings = (window.field, window.specific_force, rate)
    for (sensor, limit), values in zip(NO_UNIT_EXPLAINS.items(), readings, strict=True):
        largest = float(np.abs(values).max(initial=0.0))
        if largest > limit:
            raise Refusal(
                Reason.NOT_FINITE,
                f"The {sensor} reads up to {largest:.0e}, which no unit explains. "
                "Check its driver.",
            )
    if len(window) < min_samples:
        raise Refusal(
            Reason.TOO_FEW_SAMPLES,
            f"Only {len(window)} samples; at least {min_samples} are needed. Turn more "
            "slowly or check the rate of the topics.",
        )
    if usual_size(window.specific_force) < WEAKEST_FORCE:
        raise Refusal(
            Reason.GRAVITY_ABSENT,
            "The accelerometer shows no gravity. It must publish specific force in m/s², +9.81 "
            "upwards at rest: gravity must not be removed.",
        )
    if usual_size(window.field) < STREAMS.smallest:
        raise Refusal(
            Reason.FIELD_ABSENT, "The magnetometer reads zero. Check its driver and its topic."
        )


def refuse_milliseconds(time: FloatArray) -> None:
    """Raise `Refusal` if the stamps (n,) of a turn or a drive can only be milliseconds.

    They make a turn longer than any turn, of samples too far apart for a long drive.
    """
    gaps = np.diff(time)
    span, usual = float(gaps.sum()), float(np.median(gaps))
    if span > STREAMS.longest_pause and usual > STREAMS.longest_gyro_step:
        raise Refusal(
            Reason.NOT_FINITE,
            f"By their stamps the samples span {span:.3g} s, {usual:.3g} s apart: the stamps must "
            "be seconds, not milliseconds.",
        )


@dataclass(frozen=True)
class Screening:
    """Bounds beyond which a turn is refused."""

    least_motion: float = 2.5  # least spread of the raw field over its noise
    smallest_motion: float = 0.005  # least spread of the field, or of the force, over its size
    least_arc: float = math.radians(45.0)
    least_arc_alone: float = math.radians(90.0)
    """Radians; the latter without a known field or a gyro."""
    arc_tolerance: float = math.radians(1.5)  # uncertainty of the ends of an arc, radians
    smallest_radius: float = 0.1
    """Radius of the circle over the field's strength, below which the heading is mostly noise."""
    steepest: float = math.radians(84.0)
    """Radians of inclination at which too little of the field is level for a compass."""
    worst_field_noise: float = 0.15
    """Over the field's strength, also of the field of a tumbled sensor."""
    worst_wobble: float = math.radians(30.0)
    """Radians beyond which a robot does not turn about one axis."""
    fewest_inliers: float = 0.4  # share of the samples
    widest_rival: float = math.radians(5.0)
    """Radians of heading by which rival solutions may differ."""


SCREENING = Screening()


def check_window(window: Window, knowledge: Knowledge) -> None:
    """Raise `Refusal` for an unusable window, a field that is too steep, or a constant field."""
    refuse_empty(window)
    refuse_milliseconds(window.time)
    dip = knowledge.reference.inclination
    if not dip.is_unknown and abs(dip.value) > SCREENING.steepest:
        raise _too_steep(dip.value)
    if visible_motion(window.field):
        return
    if visible_motion(window.specific_force):
        raise Refusal(
            Reason.AXIS_ALONG_FIELD,
            "the robot turned but its field did not change: the axis lies along the field; turn"
            " about another axis",
        )
    if window.angular_rate is not None:
        about_up = window.angular_rate @ unit(window.specific_force.mean(axis=0))
        turned = float(np.ptp(integral(window.time, about_up)))
        if turned > SCREENING.least_arc:
            raise Refusal(
                Reason.FIELD_TOO_STEEP,
                f"the gyro shows a turn of {math.degrees(turned):.0f} degrees, but the field did "
                "not change: it is too steep for a compass here, or the magnetometer does not "
                "measure it",
            )
    raise Refusal(
        Reason.NO_MOTION,
        "the field did not change, so the robot did not turn; turn it once about its vertical axis",
    )


def visible_motion(values: FloatArray) -> bool:
    """Return whether vectors (n, 3) spread by more than their sample-to-sample noise."""
    clean = values[without_spikes(values)]
    if len(clean) < len(values) // 2:
        clean = values
    noise = float(np.median(np.abs(np.diff(clean, axis=0)))) / 0.954
    spread = math.sqrt(max(float(plane_normal(clean)[1][-1]), 0.0))
    size = usual_size(clean)
    return spread > max(SCREENING.smallest_motion * size, SCREENING.least_motion * noise)


def check_radius(across: float, inclination: float, tilt: float = math.inf) -> None:
    """Raise `Refusal` if the circle's radius over the field's strength, `across`, is too small.

    The inclination, and the largest possible `tilt` of the turn's axis, are in radians.
    """
    if abs(inclination) > SCREENING.steepest:
        raise _too_steep(inclination)
    if across >= SCREENING.smallest_radius:
        return
    steep = 0.5 * math.pi - abs(inclination)
    if 2.0 * SCREENING.smallest_radius < math.sin(steep) and tilt > 0.5 * steep:
        raise Refusal(
            Reason.AXIS_ALONG_FIELD,
            "the robot turned about an axis along the field, so the samples do not depend on the "
            "heading; turn about a vertical axis",
        )
    raise Refusal(
        Reason.CIRCLE_TOO_SMALL,
        f"the radius of the field's circle is only {across:.0%} of its strength; turn about an "
        "axis at a larger angle to the field, or check the field's strength and unit (tesla)",
    )


def check_arc(arc: float, *, solved_by_knowledge: bool, tolerance: float = 0.0) -> None:
    """Raise `Refusal` if a turn of `arc` radians is too short.

    `solved_by_knowledge` is whether the reference field is known or there is a gyro; the ends of
    the arc have a tolerance, radians.
    """
    least = SCREENING.least_arc if solved_by_knowledge else SCREENING.least_arc_alone
    if arc >= least - tolerance:
        return
    remedy = (
        "turn further, if possible a full circle"
        if arc < SCREENING.least_arc
        else "turn further, or give the field's strength and inclination, or use a gyro"
    )
    raise Refusal(
        Reason.ARC_TOO_SHORT,
        f"the robot turned by {math.degrees(arc):.0f}°, which is too little; {remedy}",
    )


def _too_steep(inclination: float) -> Refusal:
    # A search may leave the range of inclinations.
    steep = math.degrees(math.asin(math.sin(inclination)))
    return Refusal(
        Reason.FIELD_TOO_STEEP,
        f"at an inclination of {steep:.0f} degrees the horizontal field is too weak for a "
        "compass; use another source of heading here",
    )
