"""The bounds that a calibration from a drive is graded by."""

from __future__ import annotations

from magcal_ros.core.assessment.grading import Aspect, Bound
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.samples.units import Z_NOT_UP

DRIVE_ON = "drive on, with bends to both sides, to all headings"
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
    Bound(
        Figure.INSTALLATION_ANGLE,
        15.0,
        45.0,
        "installation error",
        "give the sensor's nominal pose with mount_rpy_deg",
        excellent=5.0,
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
"""From simulated drives and twelve recordings. The most important come first."""
