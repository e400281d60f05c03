"""What a worker is asked for by self-calibration, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.keeping.candidates import DriveCandidate
from magcal_ros.core.keeping.proofs import Proof
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoothing.log import DriveLog


class Step(NamedTuple):
    """A correction, and the clock from which road is read by it, seconds."""

    since: float
    correction: Correction


@dataclass(frozen=True, eq=False)
class Contest:
    """Two calibrations to be compared on road.

    Parameters
    ----------
    name : str
        Whose it is, to tell the answers apart.
    old : Correction
    new : tuple of Step
        One after another, each for the road that it was not fitted to; what is before the first
        does not count.
    """

    name: str
    old: Correction
    new: tuple[Step, ...]


@dataclass(frozen=True, eq=False)
class DriveJob:
    """One look at a drive; all that a worker needs, and it can be sent to one.

    Parameters
    ----------
    log : DriveLog
        The last minutes.
    knowledge : Knowledge
    in_force : Calibration or None
    windows : tuple of float
        Seconds of the newest road to which all twelve numbers are fitted.
    not_before : float
        Clock before which no window begins, seconds: something changed there.
    changed : float
        Clock of the change after which what is in force was fitted; minus infinity without one.
    contests : tuple of Contest
    """

    log: DriveLog
    knowledge: Knowledge
    in_force: Calibration | None
    windows: tuple[float, ...]
    not_before: float
    changed: float
    contests: tuple[Contest, ...]


@dataclass(frozen=True, eq=False)
class Findings:
    """What came of a look.

    Parameters
    ----------
    clock : float
        Of the newest road, seconds.
    candidates : tuple of DriveCandidate
    since_change, finer : DriveCandidate or None
        The hard iron of all road since a change that is suspected, and since the one that was
        proved.
    proofs : dict of str to Proof
        By the contests' names.
    """

    clock: float
    candidates: tuple[DriveCandidate, ...]
    since_change: DriveCandidate | None
    finer: DriveCandidate | None
    proofs: dict[str, Proof]
