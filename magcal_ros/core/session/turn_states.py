"""The states of a turn, each with the data that it needs."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.multi_turn.keep import Kept
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.session import Session
from magcal_ros.core.session.turn_events import Brief


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
    previewed_since: float | None = None
    next_preview: float = 0.0


@dataclass(frozen=True, eq=False)
class Fitting:
    """A window is being fitted, on top of the turns that were kept when it began."""

    why_ended: str
    window: Window
    kept: Kept


@dataclass(frozen=True, eq=False)
class Reporting:
    """The outcome is known; its report is being begun."""

    outcome: Outcome
    words: str


@dataclass(frozen=True)
class Saving:
    """The new calibration is in force and is being written to disk."""

    words: str
    report: str


Stand: TypeAlias = Collecting | Fitting | Reporting | Saving | None

STATES = {
    Collecting: TurnState.COLLECTING,
    Fitting: TurnState.FITTING,
    Reporting: TurnState.FITTING,
    Saving: TurnState.SAVING,
}
