"""What a report is about."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime

from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True, eq=False)
class Subject:
    """One calibration, or one attempt, as a report tells it.

    Parameters
    ----------
    window : Window
        The samples.
    knowledge : Knowledge
        What was known beforehand.
    outcome : Outcome
        What came of it; a refusal is reported too.
    source : str
        Where the samples came from: topics, or a recording. Any text: it is escaped.
    method : str
        Name of the method that was asked for.
    created : datetime
        When the calibration was made; this moment unless given.
    title : str
        Headline of the report.
    magnetometer_frame, imu_frame : str
        `frame_id` of field and IMU where they are known. Any text: it is escaped.
    vehicle : str
        How the IMU sits in the vehicle, where driving has shown it.
    """

    window: Window
    knowledge: Knowledge
    outcome: Outcome
    source: str
    method: str
    created: datetime = field(default_factory=lambda: datetime.now().astimezone())
    title: str = "Compass calibration"
    magnetometer_frame: str = ""
    imu_frame: str = ""
    vehicle: str = ""

    @property
    def answered_by(self) -> str:
        """Name of the method that gave the answer: a turn may have been told better as a drive."""
        estimate = self.outcome.estimate
        return self.method if estimate is None else estimate.method
