"""The bounds that calibrations from drives and from known headings are graded by."""

from __future__ import annotations

from magcal_ros.core.assessment.grading import SITS_OTHERWISE, Aspect, Bound
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.samples.units import Z_NOT_UP

DRIVE_ON = "drive on, with bends to both sides, to all headings"
SITS_STRAIGHT: tuple[Bound, ...] = (
    Bound(
        Figure.INSTALLATION_ANGLE,
        15.0,
        45.0,
        "installation error",
        "give the sensor's nominal pose with mount_rpy_deg",
        excellent=5.0,
        when_refused=SITS_OTHERWISE,
    ),
    Bound(
        Figure.AXIS_LEAN,
        45.0,
        90.0,
        "up is tilted from the body's z by",
        Z_NOT_UP,
        excellent=20.0,
    ),
)
"""Whether the sensors sit on the robot as expected."""
DRIVE_BOUNDS: tuple[Bound, ...] = (
    Bound(
        Figure.HEADING_SIGMA,
        2.0,
        12.0,
        "predicted heading error on the level (1σ)",
        DRIVE_ON,
        excellent=0.7,
        aspect=Aspect.CONFIDENCE,
    ),
    Bound(
        Figure.HEADINGS_DRIVEN,
        8.0,
        6.0,
        "headings driven, of 12:",
        DRIVE_ON,
        excellent=11.0,
        unit="",
        aspect=Aspect.CONFIDENCE,
        at_least=True,
    ),
    Bound(
        Figure.OUTLIER_SHARE,
        15.0,
        50.0,
        "samples left out as outliers",
        "something magnetic was near or switched; drive elsewhere",
        excellent=5.0,
        unit="%",
    ),
    Bound(
        Figure.LEVEL_PULL,
        2.0,
        20.0,
        "level field deviates from the reference by",
        "check the reference field, or mount the sensor away from steel that weakens it",
        excellent=1.0,
        unit="σ",
    ),
    *SITS_STRAIGHT,
)
"""From simulated drives and twelve recordings. The most important come first."""

ONE_MORE = "stand at another known heading"
HEADING_BOUNDS: tuple[Bound, ...] = (
    Bound(
        Figure.HEADING_SIGMA,
        3.0,
        12.0,
        "predicted heading error on the level, over all headings (1σ)",
        ONE_MORE,
        excellent=1.0,
        aspect=Aspect.CONFIDENCE,
        when_refused=f"{ONE_MORE}, and give the reference field",
    ),
    Bound(
        Figure.KNOWN_HEADINGS,
        2.0,
        1.0,
        "known headings:",
        f"{ONE_MORE}: one alone shows what is right near it",
        excellent=3.0,
        unit="",
        aspect=Aspect.CONFIDENCE,
        at_least=True,
    ),
    Bound(
        Figure.HEADING_MISFIT,
        1.5,
        4.0,
        "known headings and field are apart by",
        "check the headings and their sigma, and stand away from iron",
        excellent=1.2,
        unit=" times their sigma",
    ),
    *SITS_STRAIGHT,
)
"""From simulated robots at known headings."""
