"""How far and how long a robot may turn itself at most, independent of all other checks."""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.session.rotation_plan import Seen, planned_duration


@dataclass(frozen=True)
class RotationLimitsTuning:
    """Limits of a robot that turns itself.

    Attributes
    ----------
    leeway : float
        The two turns may take so many times as long as planned, and be commanded so many
        times as far: wheels slip.
    farthest_beyond : float
        Radians that a robot may stand beyond either end of its full turn, by the gyro: it
        coasts.
    """

    leeway: float = 1.5
    farthest_beyond: float = math.radians(45.0)


TUNING = RotationLimitsTuning()


class RotationLimits:
    """Measures a robot's turn by the gyro, and by the commands times their time.

    Whichever of the two reaches its end first ends the motion.

    Parameters
    ----------
    speed : float
        rad/s.
    now : float
        Seconds on a steady clock, as the robot sets off.
    longest : float
        Seconds that it may take at most.

    Attributes
    ----------
    objection : str
        Why it must not turn on; empty while it may.
    """

    def __init__(self, speed: float, now: float, longest: float = math.inf) -> None:
        self.objection = ""
        self._deadline = now + min(longest, TUNING.leeway * planned_duration(speed))
        self._noted = now
        self._commanded = self._path = 0.0

    def is_late(self, now: float) -> bool:
        """Whether the time for the turn is up."""
        return now > self._deadline

    def note(self, now: float, command: float, seen: Seen) -> None:
        """Take the command (rad/s) that was in force until `now`, and what the sensors show."""
        step, self._noted = (now - self._noted) * command, now
        self._commanded += step
        self._path += abs(step)
        if self.objection:
            return
        if (
            seen.by_gyro
            and not -TUNING.farthest_beyond <= seen.turned <= math.tau + TUNING.farthest_beyond
        ):
            self.objection = (
                f"by the gyro it is at {math.degrees(seen.turned):+.0f}° of a turn that goes "
                "from 0° to 360°"
            )
        elif (
            abs(self._commanded) > TUNING.leeway * math.tau
            or self._path > TUNING.leeway * 2.0 * math.tau
        ):
            self.objection = (
                f"{math.degrees(self._path):.0f}° were commanded, and its turn is not complete"
            )
