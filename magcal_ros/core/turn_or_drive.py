"""Whether a window was a turn on the spot or a drive (doc/estimator.md, section 9).

Both models answer many windows. A turn's knows that the robot came back to the same place; a
drive's knows streets, and centripetal acceleration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from magcal_ros.core.assessment.grading import Aspect, Grade
from magcal_ros.core.assessment.verdict import Verdict, VerdictTuning
from magcal_ros.core.calibration.estimate import Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import predicted_heading_sigma, rms_apart
from magcal_ros.core.doctor.refusal import wrong_axes
from magcal_ros.core.errors import Reason
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoothing.log import DriveLog

ROBOTS_OWN = (Figure.AXIS_LEAN, Figure.INSTALLATION_ANGLE)
"""What a turn shows of a robot better than a drive."""
TURNED_TOO_LITTLE = (Reason.ARC_TOO_SHORT, Reason.NO_MOTION, Reason.FIELD_ON_A_LINE)


@dataclass(frozen=True)
class TurnOrDriveTuning:
    """When a window is told better as a drive.

    Parameters
    ----------
    rough, rough_of_vehicles : float
        Radians of heading sigma from which a turn gives way to a drive that is more certain; the
        other where it jolted as vehicles do.
    surer : float
        Times the turn's sigma that such a drive's has to be at most.
    alike : float
        Of their sigmas together, how far such a drive may be from the turn: beyond it one of the
        two is wrong, and it is the drive that takes a gyro's bias for centripetal acceleration.
    doubted : float
        Of the heading between the two, what stays in doubt of the drive; one sigma.
    clearly : float
        Independent units of minus log likelihood by which a drive contradicts a turn's calibration.
    jolted : float
        Radians of jolts (`DriveLog.jolts`) from which it is a vehicle; below, a robot whose gyro no
        rest has shown, or whose motors a turn has shown, turned on the spot.
    shortest : float
        Seconds of movement below which a window is a turn or nothing.
    """

    rough: float = VerdictTuning().rough
    rough_of_vehicles: float = math.radians(2.0)
    surer: float = 0.8
    alike: float = 1.0
    doubted: float = 0.5
    clearly: float = 12.0
    jolted: float = 0.0085
    shortest: float = 15.0


TUNING = TurnOrDriveTuning()


class Turned(Protocol):
    """What a turn's model makes of a window."""

    @property
    def verdict(self) -> Verdict:
        """How it is judged."""

    @property
    def reason(self) -> Reason | None:
        """Why nothing could be found."""

    @property
    def window(self) -> Window | None:
        """The samples."""


def may_be_a_drive(turn: Turned, log: DriveLog, knowledge: Knowledge) -> bool:
    """Return whether a drive's model is asked what it makes of a turn.

    Parameters
    ----------
    turn : Turned
    log : DriveLog
        What was driven meanwhile.
    knowledge : Knowledge
    """
    if log.seconds < TUNING.shortest:
        return False
    if turn.verdict.accepted:
        return not (_stayed(log) or _shows_motors(turn.verdict, log))
    return not _is_refused_for_good(turn, log, knowledge)


def turned_with_a_bad_gyro(turn: Turned, log: DriveLog) -> bool:
    """Return whether a turn on the spot was refused for its gyro, which a drive can follow.

    Nothing jolted, so that nothing pulled: the turn can be told without a gyro.

    Parameters
    ----------
    turn : Turned
    log : DriveLog
    """
    return turn.reason is Reason.AXES_DISAGREE and _stayed(log)


def leans_more(drive: Verdict, turn: Verdict) -> bool:
    """Return whether a drive has a sensor or an axis lean too far which does not in the turn.

    What the turn shows better is then not its own: gyro bias was taken for linear acceleration.
    """
    return not (_blamed(drive) - _blamed(turn)).isdisjoint(ROBOTS_OWN)


def doubt_of_drive(
    drive: Estimate, turn: Estimate, log: DriveLog, knowledge: Knowledge
) -> float | None:
    """Return what stays in doubt of a drive that tells more than a turn, None where it does not.

    It does where the turn is rough, and where along the road the turn's is by far the less likely.

    Parameters
    ----------
    drive, turn : Estimate
    log : DriveLog
    knowledge : Knowledge

    Returns
    -------
    float or None
        Radians of heading, one sigma, beside the drive's own: part of what a rough turn differs by.
    """
    by_drive, by_turn = (predicted_heading_sigma(each, 0.0) for each in (drive, turn))
    if by_drive > by_turn:
        return None
    if by_turn > (TUNING.rough_of_vehicles if _jolts(log) else TUNING.rough):
        field = turn.strength, turn.inclination
        gap = rms_apart(turn.correction, drive.correction, *field)
        is_alike = gap < TUNING.alike * math.hypot(by_drive, by_turn)
        doubted = TUNING.doubted * gap
        is_surer = math.hypot(by_drive, doubted) < TUNING.surer * by_turn
        return doubted if is_alike and is_surer else None
    from magcal_ros.core.smoothing.fit import likelihood_ratio

    nodes = log.nodes(knowledge.mounting.to_body)
    gain = likelihood_ratio(nodes, turn.correction, drive.correction, knowledge).gain
    return 0.0 if gain > TUNING.clearly else None


def rests_differ(turn: Verdict) -> bool:
    """Return whether the field at rest beside a turn differs from that in the turn."""
    return Figure.MOTOR_FIELD in _blamed(turn)


def _stayed(log: DriveLog) -> bool:
    # Only a rest separates linear acceleration from gyro bias; else no jolts means no drive.
    return log.stays or (math.isinf(log.bias_sigma) and not _jolts(log))


def _jolts(log: DriveLog) -> bool:
    return log.jolts >= TUNING.jolted


def _shows_motors(turn: Verdict, log: DriveLog) -> bool:
    """Whether a turn tells of motors what along the road passes for a place left."""
    return not _jolts(log) and rests_differ(turn)


def _blamed(verdict: Verdict) -> set[Figure | Reason]:
    return {check.figure for check in verdict.checks if check.grade.rank >= Grade.WARN.rank}


def _is_refused_for_good(turn: Turned, log: DriveLog, known: Knowledge) -> bool:
    """Whether a turn was refused for what a drive does not see, or sees no better.

    How the sensors are mounted is one; where a robot stays it is all but that the turn was too
    short, or its answer too uncertain: a drive's model knows streets, and there are none.
    """
    checks = [check for check in turn.verdict.checks if check.grade is Grade.REFUSED]
    if any(check.figure in ROBOTS_OWN for check in checks):
        return True
    if turn.reason is Reason.AXES_DISAGREE and turn.window is not None:
        return log.stays or wrong_axes(turn.window, known) is not None
    is_bad = any(check.aspect is Aspect.QUALITY for check in checks)
    return log.stays and is_bad and turn.reason not in TURNED_TOO_LITTLE
