"""How a recheck looks, and the bounds that it grades by."""

from __future__ import annotations

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
    """How a recheck looks.

    Parameters
    ----------
    bounds : tuple of Bound
        The bounds of the grades.
    bins : int
        Sectors of heading over which a mean is taken: narrow against two swings a turn.
    longest_piece : float
        Seconds over which the gyro's drift is taken as steady.
    visit : float
        Seconds within which a robot that drives meets the same disturbance: streets are alike for
        25 to 30 m.
    own_share : float
        Of the bound of what is stale: so much of a swing the calibration's own sigma explains.
    steepest_nose : float
        Squared share of up along body x (60°) beyond which yaw is not compared.
    """

    bounds: tuple[Bound, ...] = RECHECK_BOUNDS
    bins: int = 36
    longest_piece: float = 60.0
    visit: float = 12.0
    own_share: float = 0.25
    steepest_nose: float = 0.75
