"""What a drive shows of iron that was added since a calibration was made.

Streets bend the field, alike over tens of metres, and a swing over the headings of a drive may be
theirs. The smoother gives each place its own bend; what is left is the robot's own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.assessment.grading import Bound, Check
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.knowledge import (
    INCLINATION_SIGMA_DEG,
    STRENGTH_SIGMA_UT,
    Belief,
    Knowledge,
    ReferenceField,
)
from magcal_ros.core.smoothing.fit import fit_iron
from magcal_ros.core.smoothing.log import DriveLog

CHANGE = Bound(
    Figure.HARD_IRON_CHANGE,
    6.0,
    12.0,
    "hard iron that was added since, against the level field, as the drive shows it",
    "the robot's own field has changed",
    unit="%",
)


@dataclass(frozen=True)
class IronAddedTuning:
    """When a drive shows iron that was added.

    Parameters
    ----------
    largest_sigma : float
        Of the iron, against the level field, beyond which a drive shows nothing of it.
    chance : float
        Its sigmas that chance may be.
    """

    largest_sigma: float = 0.06
    chance: float = 2.0


TUNING = IronAddedTuning()


def iron_added(drive: DriveLog, calibration: Calibration) -> Check | None:
    """Weigh the hard iron that was added; None where the drive is too short to show it.

    Parameters
    ----------
    drive : DriveLog
    calibration : Calibration
        In force since before the drive.
    """
    reference = ReferenceField(
        Belief(calibration.strength, STRENGTH_SIGMA_UT * 1e-6),
        Belief(calibration.inclination, math.radians(INCLINATION_SIGMA_DEG)),
    )
    known = Knowledge(reference)
    correction = calibration.correction
    found = fit_iron(drive.nodes(known.mounting.to_body), correction, known)
    if found is None:
        return None
    # On the level across body z; an iron along it is a matter of slopes.
    matrix = correction.matrix[:2]
    added = matrix @ (found.twelve.correction.hard_iron - correction.hard_iron)
    covariance = matrix @ found.twelve.covariance[9:, 9:] @ matrix.T
    level = calibration.strength * math.cos(calibration.inclination)
    share = math.hypot(*added) / level
    sigma = math.sqrt(float(covariance.trace()) / 2.0) / level
    if sigma > TUNING.largest_sigma:
        return None
    excess = math.sqrt(max(share**2 - (TUNING.chance * sigma) ** 2, 0.0))
    return CHANGE.check(share, excess=excess)
