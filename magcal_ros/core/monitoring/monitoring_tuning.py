"""How a turn is checked again and a drive is monitored, and the bounds they are graded by."""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.assessment.grading import Aspect, Bound
from magcal_ros.core.calibration.figure import Figure

MOVED = "the hard iron has changed, or the field is distorted here"

RECHECK_BOUNDS: tuple[Bound, ...] = (
    Bound(
        Figure.HEADING_SWING,
        4.0,
        7.0,
        "heading swing that the level field shows",
        MOVED,
    ),
    Bound(
        Figure.GYRO_COMPASS_DIFFERENCE,
        4.0,
        7.0,
        "gyro against compass",
        "the compass does not turn as the robot does",
    ),
    Bound(
        Figure.STRENGTH_SPREAD,
        3.0,
        6.0,
        "field strength varies with heading by",
        MOVED,
        unit="%",
    ),
    Bound(
        Figure.DIP_SPREAD,
        2.0,
        4.0,
        "angle between field and up varies with heading by",
        MOVED,
    ),
    Bound(
        Figure.STRENGTH_OFFSET,
        5.0,
        15.0,
        "field strength is off the calibrated one by",
        "another place, or the hard iron along the turn's axis has changed",
        unit="%",
    ),
    Bound(
        Figure.DIP_OFFSET,
        3.0,
        8.0,
        "inclination is off the calibrated one by",
        "another place, or the hard iron along the turn's axis has changed",
    ),
    Bound(
        Figure.ARC,
        270.0,
        0.0,
        "the turn covers",
        "the headings that were not seen are not checked",
        aspect=Aspect.CONFIDENCE,
        at_least=True,
    ),
)
"""Nothing is better than good: that a calibration holds is all that a recheck can say."""


@dataclass(frozen=True)
class RecheckTuning:
    """How a recheck looks."""

    bounds: tuple[Bound, ...] = RECHECK_BOUNDS
    """The bounds of the grades."""
    bins: int = 36
    """Sectors of heading over which a mean is taken: narrow against two swings a turn."""
    longest_piece: float = 60.0
    """Seconds over which the gyro's drift is taken as steady."""
    visit: float = 12.0
    """Seconds within which a robot that drives meets the same disturbance: streets are alike for 25
    to 30 m."""
    own_share: float = 0.25
    """Of the bound of what is stale: so much of a swing the calibration's own sigma explains."""
    steepest_nose: float = 0.75
    """Squared share of up along body x (60°) beyond which yaw is not compared."""


AGAIN = "calibrate again"
WATCH_BOUNDS: tuple[Bound, ...] = (
    Bound(
        Figure.HARD_IRON_CHANGE,
        3.5,
        10.0,
        "the level hard iron has changed, in the field's strength, by",
        f"something magnetic was added to the robot, taken off or moved; {AGAIN}",
        unit="%",
    ),
    Bound(
        Figure.SOFT_IRON_CHANGE,
        4.0,
        10.0,
        "the field's strength swings twice a turn, as soft iron makes it, by",
        f"iron near the sensor or a gain of the sensor has changed; {AGAIN}",
        unit="%",
    ),
    Bound(
        Figure.MOUNTING_CHANGE,
        3.0,
        8.0,
        "the field has tilted against gravity by",
        f"the magnetometer or the IMU was moved on the robot; {AGAIN}",
    ),
    Bound(
        Figure.STRENGTH_SHIFT,
        8.0,
        15.0,
        "at all headings the field's strength is off the calibrated one by",
        "the robot has moved to another place, or iron above or below the sensor has changed; "
        "give the reference field of this place and calibrate here",
        unit="%",
    ),
    Bound(
        Figure.DIP_SHIFT,
        4.0,
        8.0,
        "at all headings the inclination is off the calibrated one by",
        "the robot has moved to another place, or iron above or below the sensor has changed; "
        "give the reference field of this place and calibrate here",
    ),
    Bound(
        Figure.GYRO_COMPASS_HARMONIC,
        4.0,
        7.0,
        "gyro against compass",
        "the compass does not turn as the robot does",
    ),
)
"""As those of a recheck; the records of a drive show what has changed."""


@dataclass(frozen=True)
class WatchTuning:
    """How a drive is watched."""

    bounds: tuple[Bound, ...] = WATCH_BOUNDS
    """The bounds of the grades."""
    memory: float = 600.0
    """Seconds of driving that are looked at."""
    most_records: int = 400
    """Visits that are kept at most."""
    aside: float = math.radians(12.0)
    """Radians; a robot that has turned so far from where a visit began looks to another heading."""
    longest_visit: float = 4.0
    """Seconds after which a visit is recorded, though the robot has not turned away."""
    most_in_a_row: int = 3
    """Records of one heading; the next one takes the place of the last."""
    sampling: float = 0.08
    """Seconds between samples of a visit: more would only cost."""
    look_every: float = 15.0
    """Seconds between two looks at the records."""
    confirm: float = 60.0
    """Seconds for which every look must say the same before it is believed."""
    steepest_nose: float = RecheckTuning.steepest_nose
    """Squared share of up along body x (60°) beyond which yaw is not compared."""
    longest_piece: float = RecheckTuning.longest_piece
    """Seconds over which the gyro's drift is taken as steady."""
    sectors: int = 12
    fewest_sectors: int = 8
    """Sectors of heading, and how many must have been driven before swings can be told."""
    widest_hole: float = math.radians(100.0)
    """Radians of heading that may be missing in one stretch."""
    fewest_records: int = 40
    """Before anything is judged."""
    shortest_span: float = 150.0
    """Seconds that the records must span: a disturbance that passes is shorter."""
    clearly: float = 4.0
    few: float = 10.0
    """A swing counts when it is `clearly (1 + few/n)` times its own standard deviation, of which n
    independent stretches of driving know little when they are few."""
    promise: float = 3.0
    """Standard deviations of what the calibration promised that are no change."""
    largest_promise: float = 0.1
    """Radians; a calibration that promises less than this widens no bound any further."""
    correlation_time: float = 30.0
    """Seconds over which the records' errors are taken to be alike, less and less."""
    huber: float = 1.5
    """Scatters from which a record weighs less."""
    rounds: int = 8
    """Of reweighting."""
    smallest_scatter: float = 0.002
    """Of the field; records are never believed to agree better."""
    fastest_curve: float = 0.15
    """s/m, standard deviation of driving speed over gravity: how far curves may lean up, per
    rad/s."""
    lost: float = math.radians(20.0)
    """Radians of compass against gyro, from which a compass that shows few headings is not to be
    believed."""
    fewest_turned: float = 0.9 * math.tau
    """Radians that the gyro must have turned to be compared with the compass."""
