"""The commands and states of the state machine of a turn."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import ClassVar, TypeAlias

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.multi_turn.result import Kept
from magcal_ros.core.samples.rest import GyroAtRest
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.session import Limits, Session


@dataclass(frozen=True)
class Conclusion:
    """How a turn ended, or what a request led to.

    As a command: answer everyone who waits for the turn, and release what computes for it.
    """

    success: bool
    message: str


@dataclass(frozen=True)
class Brief:
    """What a turn is opened with."""

    limits: Limits
    knowledge: Knowledge
    method: str
    """One of `magcal_ros.core.calibrate.METHODS`."""
    accumulate: bool
    speed: float | None = None  # rad/s of a robot that turns itself; None if a person turns it
    gyro: GyroAtRest | None = None  # what a rest before the turn has shown of the gyro


@dataclass(frozen=True, eq=False)
class Preview:
    """Predict how certain a fit would be; answered by `note_preview`."""

    window: Window
    brief: Brief


@dataclass(frozen=True, eq=False)
class FitTurn:
    """Fit a turn on top of those kept; answered by `note_fit` or `note_failed_fit`."""

    kept: Kept
    window: Window
    brief: Brief


@dataclass(frozen=True, eq=False)
class PutInForce:
    """Use a calibration from now on and store it; answered by `note_saved`."""

    calibration: Calibration


@dataclass(frozen=True)
class MoveBase:
    """Tell the base to turn at a rate, rad/s, left positive."""

    rate: float


class TurnState(str, Enum):
    """The state of a turn."""

    IDLE = "idle"
    COLLECTING = "collecting"
    FITTING = "fitting"
    SAVING = "saving"


@dataclass(frozen=True, eq=False)
class Collecting:
    """Samples arrive; a preview of the fit is running or is planned."""

    brief: Brief
    session: Session
    state: ClassVar = TurnState.COLLECTING
    asked: Preview | None = None
    asked_at: float = 0.0
    next_preview: float = 0.0


@dataclass(frozen=True, eq=False)
class Fitting:
    """A window is being fitted."""

    why_ended: str
    asked: FitTurn
    state: ClassVar = TurnState.FITTING


@dataclass(frozen=True)
class Saving:
    """The new calibration is in force and is being written to disk."""

    words: str
    report: str
    state: ClassVar = TurnState.SAVING


TurnStage: TypeAlias = Collecting | Fitting | Saving
Command: TypeAlias = Conclusion | Preview | FitTurn | PutInForce | MoveBase
"""Something that the owner of the state machine has to do."""
