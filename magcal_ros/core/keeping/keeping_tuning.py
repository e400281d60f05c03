"""When a calibration from driving is fitted, believed and put in force."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class KeepingTuning:
    """Numbers of self-calibration; seconds are of movement."""

    look_every: float = 20.0
    look_again: float = 10.0
    """Seconds between two looks, and while a changed hard iron is on probation."""
    windows: tuple[float, ...] = (120.0, 200.0, 300.0, 420.0)
    """Seconds of road to which all twelve numbers are fitted."""
    look_back: float = 240.0
    shortest_since: float = 25.0
    longest_since: float = 300.0
    """Seconds of road in which a change is looked for; least and most of the road since it to which
    the hard iron is fitted."""
    finer: float = 0.9
    """Share of its sigma below which what came of driving is replaced by what more of the same
    driving shows, where it is known more roughly than `largest_sigma`."""
    more_road: float = 1.15
    """Times the road it came of that this must be fitted to."""
    notice_sigma: float = math.radians(5.0)
    notice_differs: float = 4.0
    notice_proof: float = 5.0
    """Radians of heading to which a change of the hard iron must be known to be told, how many
    sigmas it must differ from what is in force, and by how many units of log likelihood the road
    before and since must be likelier with it."""
    plainly: float = 0.2
    """Share of the difference from what is in force that a changed hard iron may be uncertain
    by."""
    largest_sigma: float = math.radians(3.0)
    """Radians of heading beyond which a candidate is not believed."""
    fewest_sectors: int = 6
    fewest_for_iron: int = 4
    """Of twelve headings that all twelve numbers need, and the hard iron alone."""
    differs: float = 2.0
    """Sigmas by which a candidate differs from what is in force, or else nothing is to be
    mended."""
    much_better: float = 0.6
    """Share of the other's sigma below which it is taken up all the same. Where that is beyond
    `largest_sigma` and both agree, this is enough."""
    longest_probation: float = 180.0
    longest_trial: float = 300.0
    """Seconds of road after which a candidate that has not proved itself is dropped, and one in
    force is no longer compared with the one before."""
    turn: float = math.radians(30.0)
    turn_within: float = 60.0
    """Radians turned within metres that make a turn of probation."""
    fewest_turns: int = 2
    turn_proof: float = 2.5
    least_gain: float = math.log(1.1)
    """Sigmas by which turns must be quieter, and the least mean log ratio."""
    turn_spread: float = 0.35
    pseudo_turns: float = 4.0
    """Usual spread of the log ratios and how many turns it counts for."""
    likelihood_proof: float = 12.0
    iron_proof: float = 8.0
    """Fall of minus log likelihood, independent units, on the road of probation, with a rise in
    neither half; less is asked of a hard iron, which was far off already to be noticed."""
    elsewhere_proof: float = 2.0
    """Units of it that must be left without the quarter of headings that speaks most, where all
    twelve numbers are new."""
    most_against: float = 1.5
    """Units that the headings which speak against a changed hard iron may have together."""
    shortest_proof: float = 15.0
    """Seconds of road before which no likelihood is believed."""
    agree: float = 2.0
    """Sigmas within which two windows agree at the first start."""
    course_proof: float = 20.0
    """Fall of chi-square by which a candidate must explain the swing of compass against course."""
    memory: float = 600.0
    """Seconds of road that are remembered."""
    map_every: float = 0.5
    map_rows: int = 5
    """Seconds between points of the map of a drive, and the same in rows of its log."""
    kept: int = 3
    """Calibrations before the one in force that are kept."""
    remembered: int = 20
    """Decisions that are told."""


KEEPING = KeepingTuning()
