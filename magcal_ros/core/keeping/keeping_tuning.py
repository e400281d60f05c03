"""When a calibration from driving is fitted, believed and put in force."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class KeepingTuning:
    """Numbers of self-calibration; seconds are of movement.

    Parameters
    ----------
    look_every, look_again : float
        Seconds between two looks, and while a changed hard iron is on probation.
    windows : tuple of float
        Seconds of road to which all twelve numbers are fitted.
    look_back, shortest_since, longest_since : float
        Seconds of road in which a change is looked for; least and most of the road since it to
        which the hard iron is fitted.
    finer : float
        Share of its sigma below which what came of driving is replaced by what more of the same
        driving shows, where it is known more roughly than `largest_sigma`.
    more_road : float
        Times the road it came of that this must be fitted to.
    notice_sigma, notice_differs, notice_proof : float
        Radians of heading to which a change of the hard iron must be known to be told, how many
        sigmas it must differ from what is in force, and by how many units of log likelihood the
        road before and since must be likelier with it.
    plainly : float
        Share of the difference from what is in force that a changed hard iron may be uncertain by.
    largest_sigma : float
        Radians of heading beyond which a candidate is not believed.
    fewest_sectors, fewest_for_iron : int
        Of twelve headings that all twelve numbers need, and the hard iron alone.
    differs : float
        Sigmas by which a candidate differs from what is in force, or else nothing is to be mended.
    much_better : float
        Share of the other's sigma below which it is taken up all the same. Where that is beyond
        `largest_sigma` and both agree, this is enough.
    longest_probation, longest_trial : float
        Seconds of road after which a candidate that has not proved itself is dropped, and one in
        force is no longer compared with the one before.
    turn, turn_within : float
        Radians turned within metres that make a turn of probation.
    fewest_turns : int
    turn_proof, least_gain : float
        Sigmas by which turns must be quieter, and the least mean log ratio.
    turn_spread, pseudo_turns : float
        Usual spread of the log ratios and how many turns it counts for.
    likelihood_proof, iron_proof : float
        Fall of minus log likelihood, independent units, on the road of probation, with a rise in
        neither half; less is asked of a hard iron, which was far off already to be noticed.
    elsewhere_proof : float
        Units of it that must be left without the quarter of headings that speaks most, where all
        twelve numbers are new.
    most_against : float
        Units that the headings which speak against a changed hard iron may have together.
    shortest_proof : float
        Seconds of road before which no likelihood is believed.
    agree : float
        Sigmas within which two windows agree at the first start.
    course_proof : float
        Fall of chi-square by which a candidate must explain the swing of compass against course.
    memory : float
        Seconds of road that are remembered.
    map_every, map_rows : float, int
        Seconds between points of the map of a drive, and the same in rows of its log.
    kept : int
        Calibrations before the one in force that are kept.
    remembered : int
        Decisions that are told.
    """

    look_every: float = 20.0
    look_again: float = 10.0
    windows: tuple[float, ...] = (120.0, 200.0, 300.0, 420.0)
    look_back: float = 240.0
    shortest_since: float = 25.0
    longest_since: float = 300.0
    finer: float = 0.9
    more_road: float = 1.15
    notice_sigma: float = math.radians(5.0)
    notice_differs: float = 4.0
    notice_proof: float = 5.0
    plainly: float = 0.2
    largest_sigma: float = math.radians(3.0)
    fewest_sectors: int = 6
    fewest_for_iron: int = 4
    differs: float = 2.0
    much_better: float = 0.6
    longest_probation: float = 180.0
    longest_trial: float = 300.0
    turn: float = math.radians(30.0)
    turn_within: float = 60.0
    fewest_turns: int = 2
    turn_proof: float = 2.5
    least_gain: float = math.log(1.1)
    turn_spread: float = 0.35
    pseudo_turns: float = 4.0
    likelihood_proof: float = 12.0
    iron_proof: float = 8.0
    elsewhere_proof: float = 2.0
    most_against: float = 1.5
    shortest_proof: float = 15.0
    agree: float = 2.0
    course_proof: float = 20.0
    memory: float = 600.0
    map_every: float = 0.5
    map_rows: int = 5
    kept: int = 3
    remembered: int = 20


KEEPING = KeepingTuning()
