"""The assumptions of this room, by subject: each number with its unit and its reason."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class SelfCalibrationTuning:
    """Thresholds of self-calibration; seconds are of movement."""

    look_every: float = 20.0
    """Seconds between two jobs; half of it while a changed hard iron is on probation."""
    watch_every: float = 60.0  # the same if no calibration is sought
    windows: tuple[float, ...] = (120.0, 200.0, 300.0, 420.0)
    """Seconds of driving to which all twelve numbers are fitted."""
    look_back: float = 240.0
    shortest_since: float = 25.0
    """Seconds of driving in which a change is searched, and the least after a change to which the
    hard iron is fitted."""
    notice_differs: float = 4.0  # sigmas by which a changed hard iron must differ to be reported
    notice_proof: float = 2.0  # least log likelihood ratio of a change
    plainly: float = 0.2  # largest ratio of a changed iron's sigma to its difference
    largest_sigma: float = math.radians(3.0)  # of a candidate, radians
    fewest_sectors: int = 6  # of twelve headings, for all twelve numbers
    fewest_for_iron: int = 4  # the same for the hard iron alone
    differs: float = 2.0  # sigmas within which two calibrations agree
    much_better: float = 0.6
    """Ratio of sigmas below which a candidate that agrees is still used. If the other sigma is
    above `largest_sigma`, this is enough without probation."""
    longest_probation: float = 180.0  # seconds after which an unproved candidate is dropped
    longest_trial: float = 300.0  # seconds for which the previous calibration is still compared
    likelihood_proof: float = 12.0
    iron_proof: float = 8.0
    """Least log likelihood ratio on the probation's data, roadside steel allowed; both halves must
    gain. It is lower for hard iron, whose change was clear before."""
    roadside: float = 0.01
    """Prior probability of steel on one side of all roads of one quarter of the headings."""
    memory: float = 600.0  # seconds of driving that are kept
    map_every: float = 0.5  # seconds between points of the map of a drive


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
