"""The bounds of the figures of turns, drives and known headings."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

from magcal_ros.core.assessment.grading import CHECK_MOUNTING, Aspect, Bound, shown
from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import arc_sigma
from magcal_ros.core.samples.units import Z_NOT_UP

AMOUNT = partial(Bound, unit="", aspect=Aspect.CONFIDENCE, at_least=True)
"""Of how much was seen: a larger number is better."""
FULL_ARC_DEG = 300.0  # degrees of a turn from which it counts as a full circle
INSTALLATION = Bound(
    Figure.INSTALLATION_ANGLE,
    (5.0, 15.0, 45.0),
    "installation error",
    "give the sensor's nominal pose with mount_rpy_deg",
    when_refused=CHECK_MOUNTING,
)
"""Rotation of the magnetometer from its nominal pose."""
SIZE_READ = "the sensor reads the Earth's field larger or smaller than the reference by"
AGAINST_REFERENCE: tuple[Bound, ...] = (
    Bound(
        Figure.RADIUS_MISFIT,
        (3.0, 10.0, 25.0),
        SIZE_READ,
        "check the sensor's scale, and reference.strength_ut and inclination_deg, or look for soft "
        "iron and steel nearby",
        unit="%",
    ),
    Bound(
        Figure.LEVEL_SHARE,
        (97.0, 90.0, 15.0),
        "share of the level field that reaches the sensor",
        "mount the sensor away from steel, or check the reference field and the sensor's scale: a "
        "magnetometer whose scale is wrong looks the same",
        unit="%",
        at_least=True,
    ),
)
"""The level field against that of the reference."""
SIGMA = Bound(
    Figure.HEADING_SIGMA,
    (0.7, 2.0, 12.0),
    "predicted heading error on level ground (1σ)",
    "turn the full circle, or through all orientations, more slowly",
    aspect=Aspect.CONFIDENCE,
    after_full="turn once more, more slowly or on other ground",
)
"""The sigma by the calibration. One scale for turns, drives and known headings."""
UPRIGHT = Bound(Figure.AXIS_LEAN, (20.0, 45.0, 90.0), "up is tilted from the body's z by", Z_NOT_UP)
STRENGTH = Bound(
    Figure.STRENGTH_DEVIATION,
    (1.5, 3.0, 5.0),
    "field strength deviates from the reference by",
    "check reference.strength_ut, or turn where the field is undisturbed",
    unit="σ",
)
OUTLIERS = Bound(
    Figure.OUTLIER_SHARE,
    (5.0, 25.0, 50.0),
    "samples left out as outliers",
    "something magnetic passed by or was switched; turn again elsewhere",
    unit="%",
)
TURN_BOUNDS: tuple[Bound, ...] = (
    SIGMA,
    Bound(
        Figure.RESIDUAL_RATIO,
        (3.0, 6.0, 12.0),
        "residual against the level field",
        "move away from steel and motors, and keep loads still while turning",
        unit="%",
    ),
    OUTLIERS,
    *AGAINST_REFERENCE,
    Bound(
        Figure.ELLIPSE_EXCESS,
        (2.0, 12.0, 30.0),
        "ellipse in the turn's plane, ratio of its axes minus one",
        "give soft_iron_gains, or move the magnetometer away from iron parts",
        unit="%",
    ),
    Bound(
        Figure.MOTOR_FIELD,
        (0.3, 1.0, 20.0),
        "between rest and turn the field changes by",
        "if the robot rested at the place of the turn, its motors are the cause: route their "
        "wires away from the sensor, or calibrate with the motors on; if it rested elsewhere, "
        "leave that rest out",
        unit=" µT",
    ),
    Bound(
        Figure.IRON_DRIFT,
        (0.2, 0.3, 20.0),
        "from the beginning of the turn to its end the hard iron changes by",
        "let the electronics warm up, keep arms, lids and loads where they are, and turn again",
        unit=" µT",
    ),
    Bound(
        Figure.LATENCY,
        (20.0, 100.0, 1000.0),
        "the stamps of field and gyro differ by",
        "the heading is corrected for this; better let the driver stamp both when they are "
        "measured, and calibrate again",
        unit=" ms",
    ),
    Bound(
        Figure.GYRO_COMPASS_SWING,
        (1.0, 2.0, 10.0),
        "gyro against compass around the turn",
        "the field is distorted here; turn elsewhere",
        when_refused="the field is distorted here, or the axes do not match; turn elsewhere",
    ),
    STRENGTH,
    replace(
        STRENGTH,
        figure=Figure.INCLINATION_DEVIATION,
        words="inclination deviates from the reference by",
        remedy="check reference.inclination_deg, or turn where the field is undisturbed",
    ),
    INSTALLATION,
    Bound(
        Figure.INSTALLATION_YAW_SIGMA,
        (0.5, 3.0, 10.0),
        "yaw of the installation (1σ)",
        "turn on a slope",
        aspect=Aspect.CONFIDENCE,
    ),
    Bound(
        Figure.MISALIGNMENT,
        (0.5, 1.5, 5.0),
        "compared with gravity, the corrected field is rotated against the IMU by",
        "this method does not correct it; give mount_rpy_deg, or use a method that does",
    ),
    AMOUNT(
        Figure.ARC,
        (FULL_ARC_DEG, 160.0, 90.0),
        "the turn covers",
        "turn the full circle",
        unit="°",
    ),
    AMOUNT(
        Figure.SAMPLES,
        (100.0, 50.0, 19.0),
        "samples used:",
        "turn more slowly, or raise the rate of the topics",
    ),
    Bound(
        Figure.SIDEWAYS_ACCELERATION,
        (1.0, 1.5, 45.0),
        "over the turn, the acceleration is tilted from the gyro's axis by",
        "turn more slowly, and on the spot if possible; if this remains, the gyro has a large "
        "bias, or its axes do not match the accelerometer's",
    ),
    replace(
        UPRIGHT, limits=(20.0, 45.0, 75.0), words="the turn's axis is tilted from the body's z by"
    ),
)
"""From simulation and about ten recordings. The most important come first."""

MOTORS_SUBTRACTED = (
    "the node subtracts this field while the robot moves; it is better to mount the magnetometer "
    "further away from motors and power wires"
)
MOTORS_PARTLY_MEASURED = (
    "without a gyro, a part of it cannot be measured; turn the robot by hand with its motors off, "
    "or use an IMU with a gyro"
)
ALLOWED_SIGMAS = 2.0
"""Allowance of a bound in sigmas: for the reference's level field, and for the arc."""


def bounds_of(estimate: Estimate) -> tuple[Bound, ...]:
    """Return the bounds of an estimate, adapted to its figures."""
    bounds = DRIVE_BOUNDS if Figure.HEADINGS_DRIVEN in estimate.figures else TURN_BOUNDS
    bounds = HEADING_BOUNDS if Figure.KNOWN_HEADINGS in estimate.figures else bounds
    return tuple(_adapted(bound, estimate) for bound in bounds)


def _adapted(bound: Bound, estimate: Estimate) -> Bound:
    if bound.figure is Figure.RADIUS_MISFIT:
        is_larger = estimate.figures.get(Figure.RADIUS_RATIO, 1.0) > 1.0
        which = "larger" if is_larger else "smaller"
        return replace(bound, words=SIZE_READ.replace("larger or smaller", which))
    if bound.figure is Figure.MOTOR_FIELD and estimate.motors is not None:
        by_gyro = Figure.GYRO_CARRIED in estimate.figures
        remedy = MOTORS_SUBTRACTED if by_gyro else MOTORS_PARTLY_MEASURED
        return replace(bound, limits=(*bound.limits[:2], 50.0), remedy=remedy)
    if bound.figure is Figure.ARC and math.degrees(estimate.arc) > bound.warn:
        doubt = ALLOWED_SIGMAS * math.degrees(arc_sigma(estimate))
        least = round(min(bound.warn + doubt, bound.good), 1)
        unsure = f"the arc is known to ±{shown(doubt)}°, and may be less than {bound.warn:g}°; "
        limits = (*bound.limits[:2], least)
        return replace(bound, limits=limits, when_refused=unsure + bound.remedy)
    return bound


CIRCLES = "calibrate once more, with circles to both sides, or fit a longer recording"
ALL_HEADINGS = f"{CIRCLES} with all headings"
DRIVE_BOUNDS: tuple[Bound, ...] = (
    UPRIGHT,
    replace(
        SIGMA,
        words="predicted heading error on level ground by the calibration (1σ)",
        remedy=ALL_HEADINGS,
        after_full=CIRCLES,
    ),
    AMOUNT(
        Figure.HEADINGS_DRIVEN,
        (11.0, 8.0, 0.0),  # the sigma decides on a refusal
        "headings driven, of 12:",
        ALL_HEADINGS,
    ),
    replace(
        OUTLIERS,
        limits=(5.0, 15.0, 50.0),
        remedy="something magnetic was near or was switched; drive elsewhere",
    ),
    *AGAINST_REFERENCE,
    INSTALLATION,
)
"""From simulated drives and twelve recordings. The most important come first."""

ONE_MORE = "stand at another known heading"
HEADING_BOUNDS: tuple[Bound, ...] = (
    replace(
        SIGMA,
        words="predicted heading error on level ground, over all headings (1σ)",
        remedy=ONE_MORE,
        after_full="",
        when_refused=f"{ONE_MORE}, and give the reference field",
    ),
    AMOUNT(
        Figure.KNOWN_HEADINGS,
        (3.0, 2.0, 1.0),
        "known headings:",
        f"{ONE_MORE}: with one alone, the calibration is right only near it",
    ),
    Bound(
        Figure.HEADING_MISFIT,
        (1.2, 1.5, 4.0),
        "known headings and field differ by",
        "check the headings and their sigma, and stand away from iron",
        unit=" times their sigma",
    ),
    INSTALLATION,
    UPRIGHT,
)
"""From simulated robots at known headings."""
