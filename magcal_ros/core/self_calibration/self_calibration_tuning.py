"""The assumptions of this room, by subject: each number with its unit and its reason."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class SelfCalibrationTuning:
    """Priors and limits of self-calibration; seconds are of movement."""

    look_every: float = 20.0
    """Seconds between two jobs; half of it while a changed hard iron is on probation."""
    windows: tuple[float, ...] = (120.0, 200.0, 300.0, 420.0)
    """Seconds of driving to which all twelve numbers are fitted."""
    look_back: float = 240.0
    """Seconds of driving in which a change is searched, and for which two calibrations are
    compared."""
    memory: float = 600.0  # seconds of driving that are kept
    local: float = 0.01
    """Prior probability of a disturbance of the field along one part of a drive, such as steel on
    one side of all roads of one quarter of the headings."""
    notice: float = 2.0  # log odds from which a change of hard iron is reported
    proof: float = 11.0
    """Log likelihood ratio, with a local disturbance allowed, from which another calibration is
    put in force, or the one in force no longer holds. Eight are for the prior odds against a
    change, and one for each of three fitted numbers of hard iron."""
    largest_sigma: float = math.radians(3.0)  # of a candidate, radians
    plainly: float = 4.0
    """Sigmas by which a changed hard iron must differ to be reported. If it is also proved, it is
    used whatever its own sigma."""
    much_better: float = 0.6  # ratio of sigmas below which a candidate that agrees is used


@dataclass(frozen=True)
class LearningTuning:
    """Priors of robots and places."""

    body: float = 0.05  # µT per axis of the body's coloured noise at rest
    freedom: float = 5.0  # degrees of freedom of the Student distribution of samples
    iron_walk: float = 0.003  # random walk of the hard iron, µT per root second
    usual: float = 0.05  # µT, median of the field of an input at its usual size
    spread: float = 2.0  # sigma of its natural logarithm, as of `motors_moving`
    most: float = 30.0  # µT, largest such field


SELF_CALIBRATION, LEARNING = SelfCalibrationTuning(), LearningTuning()
